"""Owns the clock of the little graph and beats on every tick."""

import sys

from beats import BEAT, ECHO

from footfall.messages.topics import CLOCK
from footfall.nodes.node import Node, NodeConfig
from footfall.nodes.spin import spin


class Ticker(Node[NodeConfig]):
    inputs = (ECHO,)
    outputs = (CLOCK, BEAT)
    clock_rate_hz = 30

    def __init__(self, config, seed=0):
        super().__init__(config, seed)
        self.number = 0

    def step(self, inbox):
        self.number += 1
        return [BEAT(BEAT.type(self.number))]


if __name__ == "__main__":
    sys.exit(spin(Ticker))
