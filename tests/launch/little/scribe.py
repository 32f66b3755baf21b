"""Listens, and takes its time to write at the end what it has heard."""

import sys
import time
from pathlib import Path

from beats import BEAT

from footfall.nodes.node import Node, NodeConfig
from footfall.nodes.spin import spin


class Config(NodeConfig, frozen=True):
    path: str
    lines: int = 30


class Scribe(Node[Config]):
    Config = Config
    inputs = (BEAT,)

    def step(self, inbox):
        return []

    def close(self):
        with Path(self.config.path).open("w", buffering=1) as file:
            for number in range(self.config.lines):
                file.write(f"{number}\n")
                time.sleep(0.1)


if __name__ == "__main__":
    sys.exit(spin(Scribe))
