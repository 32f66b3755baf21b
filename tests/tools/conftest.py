"""A graph of two tiny nodes, written and recorded once, for the tests of replay and regression."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

WALKER = '''
"""Owns the clock; two people walk along x."""
import sys
import numpy as np
from footfall.messages.agents import AgentStates
from footfall.messages.map import SemanticMap
from footfall.messages.topics import AGENTS, FALLS, MAP
from footfall.nodes.node import Node, NodeConfig
from footfall.nodes.spin import spin


class Walker(Node[NodeConfig]):
    outputs = (MAP, AGENTS, FALLS)
    clock_rate_hz = 30

    def start(self):
        return [MAP(SemanticMap("yard", ["walkable"], np.ones((1, 80, 60), np.uint8), 0.1, (0.0, 0.0)))]

    def step(self, inbox):
        if round(inbox.now * 30) % 3:
            return []
        history = np.zeros((2, 31, 7), np.float32)
        history[:, -1, 0] = inbox.now
        history[1, -1, 0] += np.random.default_rng(self.seed).random()
        return [AGENTS(AgentStates(np.array([1, 2], np.int32), np.array([-1, -1], np.int32), history))]


if __name__ == "__main__":
    sys.exit(spin(Walker))
'''

KEEPER = '''
"""Keeps a score of how far people have come, which depends on its whole past."""
import sys
from footfall.messages.score import Score
from footfall.messages.topics import AGENTS, FALLS, MAP, SCORE
from footfall.nodes.node import Node, NodeConfig
from footfall.nodes.spin import spin


class Config(NodeConfig, frozen=True):
    gain: float = 1.0


def score(entered, total):
    return SCORE(Score(entered, entered, 0, 0, total, 0.0, 0.0, 0))


class Keeper(Node[Config]):
    Config = Config
    inputs = (MAP, AGENTS, FALLS)
    outputs = (SCORE,)
    requires = (MAP,)
    trigger = AGENTS

    def __init__(self, config, seed=0):
        super().__init__(config, seed)
        self.total = 0.0

    def start(self):
        return [score(0, 0.0)]

    def on_time_jump(self):
        self.total = 0.0

    def step(self, inbox):
        for agents in inbox.new(AGENTS):
            self.total += self.config.gain * float(agents.now[:, 0].sum())
        return [score(len(inbox.require(AGENTS).ids), self.total)]


if __name__ == "__main__":
    sys.exit(spin(Keeper))
'''

LAUNCH = """
name: yard
clock: {mode: lockstep}
seed: 11
duration: 12
nodes:
  walker:
    module: walker
    outputs: [clock, map, agents, falls]
  keeper:
    module: keeper
    inputs: [map, agents, falls]
    outputs: [score]
    config: {gain: 2.0}
"""


class TinyRun:
    """The folder with the nodes' modules, the launch file and the log."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.log = folder / "run.mcap"
        (folder / "walker.py").write_text(WALKER)
        (folder / "keeper.py").write_text(KEEPER)
        (folder / "yard.yaml").write_text(LAUNCH)

    def command(self, *arguments: object) -> list[str]:
        return [sys.executable, "-m", "footfall.tools.cli", *map(str, arguments)]

    def footfall(self, *arguments: object) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            self.command(*arguments), cwd=self.folder, capture_output=True, text=True, timeout=100
        )

    def json(self, *arguments: object, code: int = 0) -> dict[str, Any]:
        done = self.footfall(*arguments, "--json")
        assert done.returncode == code, done.stdout + done.stderr
        return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> TinyRun:
    run = TinyRun(tmp_path_factory.mktemp("yard"))
    summary = run.json("launch", "yard.yaml", "--record", run.log)
    assert summary["first_failure"] is None and summary["dropped"] == 0
    return run


@pytest.fixture(scope="session")
def footfall():
    """Runs a command; returns what it printed on standard output, or on standard error where it ought to fail."""

    def run(*arguments: object, code: int = 0) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "footfall.tools.cli", *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=600,
        )
        assert done.returncode == code, done.stderr
        return done.stderr if code else done.stdout

    return run
