"""Echoes every beat, and misbehaves on demand."""

import logging
import os
import signal
import subprocess
import sys
import time

from beats import BEAT, ECHO

from footfall.nodes.node import Node, NodeConfig
from footfall.nodes.spin import spin

log = logging.getLogger(__name__)

if seconds := os.environ.get("SLOW_IMPORT"):
    subprocess.Popen(["sleep", "1000"], start_new_session=True)
    time.sleep(float(seconds))
if "DIE_AT_IMPORT" in os.environ:
    sys.exit("dead on arrival")


class Config(NodeConfig, frozen=True):
    at: int = -1
    """Misbehave at this beat."""
    how: str = "raise"
    children: int = 0
    """Processes to start that do not end by themselves, in sessions of their own."""


class Echoer(Node[Config]):
    Config = Config
    inputs = (BEAT,)
    outputs = (ECHO,)
    trigger = BEAT

    def __init__(self, config, seed=0):
        super().__init__(config, seed)
        for _ in range(config.children):
            subprocess.Popen(["sleep", "1000"], start_new_session=True)

    def step(self, inbox):
        number = inbox.new(BEAT)[-1].number
        if number == self.config.at:
            self._misbehave()
        return [ECHO(ECHO.type(number))]

    def _misbehave(self):
        how = self.config.how
        if how == "raise":
            raise RuntimeError("the echo is gone")
        if how == "exit":
            print("out of here", flush=True)
            os._exit(7)
        if how == "segv":
            os.kill(os.getpid(), signal.SIGSEGV)
        if how == "hang":
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
            time.sleep(1000)
        if how == "warn":
            log.warning("an odd beat")
        if how == "finish":
            self.finished = "enough"


if __name__ == "__main__":
    sys.exit(spin(Echoer))
