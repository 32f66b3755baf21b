"""What people get wrong, and the one line each of them gets; the table is `docs/errors.md`."""

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

import footfall
from footfall.messages.clock import Clock
from footfall.messages.codec import Codec
from footfall.messages.graph import Graph
from footfall.messages.log import LogWriter
from footfall.messages.topics import CLOCK, MAP, Topic

TABLE = Path(footfall.__file__).parent / "docs" / "errors.md"

CROSSING = "include: [{file: crossing.yaml}]\n"
PLANNER_TWICE = (
    "nodes: {second: {module: footfall.nodes.planner,"
    " inputs: [map, bodies, objectives, agents], outputs: [plans]}}\n"
)
FILES = {
    "key.yaml": CROSSING + "clock: {mod: lockstep}\n",
    "choice.yaml": CROSSING + "clock: {mode: locstep}\n",
    "type.yaml": CROSSING + "seed: seven\n",
    "syntax.yaml": "nodes: {planner: [\n",
    "two.yaml": CROSSING + PLANNER_TWICE,
    "silent.yaml": "nodes: {simulator: {module: footfall.nodes.simulator, inputs: [map], outputs: [clock]}}\n",
    "port.yaml": CROSSING + "nodes: {planner: {inputs: {plns: latest}}}\n",
    "module.yaml": CROSSING + "nodes: {planner: {module: footfall.nodes.planer}}\n",
    "open.yaml": CROSSING + 'nodes: {planner: {expose: {plans: "tcp://0.0.0.0:7000"}}}\n',
    "text.mcap": "not a log\n",
    "empty.mcap": "",
}
CASES = {
    "a command that does not exist": (["lanch", "crossing"], "did you mean 'launch'"),
    "a number that is none": (["launch", "crossing", "--duration", "long"], "--duration"),
    "a launch file or scene that does not exist": (["launch", "crosing"], "did you mean 'crossing'"),
    "broken YAML": (["launch", "syntax.yaml"], "syntax.yaml"),
    "an unknown key": (["launch", "key.yaml"], "unknown key 'mod'; did you mean 'mode'"),
    "a choice that does not exist": (["launch", "choice.yaml"], "did you mean 'lockstep'"),
    "a wrong type": (["launch", "type.yaml"], "seed"),
    "an unknown setting of a node": (
        ["launch", "crossing", "--set", "planner.methd=orca"],
        "did you mean 'method'",
    ),
    "a setting out of range": (["launch", "crossing", "--set", "planner.rate_hz=0"], "rate_hz"),
    "a walker without physics": (
        ["launch", "crossing", "--set", "controller=pacer", "--set", "count=2"],
        "takes mode: physics",
    ),
    "weights that are not there": (
        ["launch", "physics", "--set", "controller.weights=nowhere.safetensors"],
        "there are no weights at nowhere.safetensors",
    ),
    "two publishers of one topic": (["launch", "two.yaml"], "nodes planner and second both publish it"),
    "a topic nobody publishes": (["launch", "silent.yaml"], "map"),
    "a port the node does not have": (["launch", "port.yaml"], "did you mean 'plans'"),
    "a module that does not exist": (["launch", "module.yaml"], "footfall.nodes.planer"),
    "an open port without keys": (["launch", "open.yaml"], "needs keys"),
    "a topic that does not exist": (["topic", "schema", "agens"], "did you mean 'agents'"),
    "no running graph": (["topic", "echo", "agents", "--run-dir", "nowhere"], "nowhere"),
    "a log that does not exist": (["log", "info", "nope.mcap"], "no such log"),
    "a file that is no log": (["log", "info", "text.mcap"], "is not an MCAP file"),
    "an empty log": (["log", "info", "empty.mcap"], "is empty"),
    "a log without what the command needs": (["log", "plot", "clock.mcap"], "map"),
    "a log of another release": (["log", "plot", "foreign.mcap"], "map@map_server was recorded as OldMap"),
    "a node the log does not know": (["regress", "clock.mcap", "--node", "plannr"], "plannr"),
    "a place that may not be written": (
        ["launch", "crossing", "--record", "locked/run.mcap"],
        "locked/run.mcap",
    ),
    "a result that would overwrite": (["log", "recover", "clock.mcap", "-o", "text.mcap"], "exists already"),
    "a port that is taken": (["launch", "taken.yaml"], "in use"),
    "a recording that does not exist": (["import", "biwi", ".", "--scene", "hotle"], "did you mean 'hotel'"),
}

CLI = ("-m", "footfall.tools.cli")
UNPRIVILEGED = ("setpriv", "--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-all")
"""Root without the right to write where nobody may."""


class OldMap(msgspec.Struct, frozen=True):
    """What `map` may have been in another release."""

    floors: int


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory):
    """A working folder with everything the cases need."""
    place = tmp_path_factory.mktemp("work")
    for name, text in FILES.items():
        (place / name).write_text(text)
    codec = Codec(CLOCK.name, Clock)
    with LogWriter(place / "clock.mcap", Graph("tiny", [])) as writer:
        writer.write(CLOCK, "simulator", 0, 0, 0, codec.encode_inline(Clock(0, 1, "free")))
    old = Topic(MAP.name, OldMap, latched=True)
    with LogWriter(place / "foreign.mcap", Graph("tiny", [])) as writer:
        writer.write(old, "map_server", 0, 0, 0, Codec(old.name, OldMap).encode_inline(OldMap(2)))
    (place / "locked").mkdir()
    (place / "locked").chmod(0o500)
    subprocess.run(
        [sys.executable, "-m", "footfall.tools.cli", "keys", "new", "graph"], cwd=place, check=True
    )
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        secret = next(place.rglob("*.key_secret"))
        (place / "taken.yaml").write_text(
            CROSSING
            + f'nodes: {{planner: {{expose: {{plans: "tcp://127.0.0.1:{taken.getsockname()[1]}"}}}}}}\n'
            + f"security: {{secret_key_file: {secret}, authorized_keys_dir: {secret.parent}}}\n"
        )
        yield place


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_one_line_and_exit_code_2(case, folder):
    arguments, hint = CASES[case]
    locked = "locked" in " ".join(arguments)
    if locked and os.geteuid() == 0 and not shutil.which("setpriv"):
        pytest.skip("root may write anywhere, and there is no setpriv to forbid it")
    result = subprocess.run(
        [*(UNPRIVILEGED if locked and os.geteuid() == 0 else ()), sys.executable, *CLI, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
    )
    lines = [line for line in result.stderr.splitlines() if line.strip()]
    assert result.returncode == 2, result.stderr
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("footfall: error: ")
    assert hint in lines[0]
    assert "Traceback" not in result.stderr


def test_every_case_stands_in_the_table():
    text = TABLE.read_text()
    missing = [case for case in CASES if f"| {case} |" not in text]
    assert not missing
    assert np.all([f"`footfall {' '.join(arguments)}`" in text for arguments, _ in CASES.values()])
