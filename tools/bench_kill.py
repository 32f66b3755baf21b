"""`footfall bench kill`: SIGKILL every process of a graph in turn; what ends, what comes back, what is left."""

import argparse
import json
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic, sleep

from ..messages.graph import LAUNCHER
from ..messages.topics import CLOCK
from .launched import Launched, set_words
from .results import table, write_section

STOP_LIMIT = 3.0
"""From the death of a required node, or of the launcher, until nothing is left [s]."""
BACK_LIMIT = 2.0
"""From the death of a restartable node to the first step of its next life [s]."""
SETTINGS = ("planner=orca",)
"""Of the crossing: a planner with a network takes longer to be back than `BACK_LIMIT` for its imports alone."""
LOG_LIMIT = 1.2
"""What a killed recorder's log may lack: it is written once a second, and not on the dot [s]."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the bench."""
    parser.add_argument(
        "name", nargs="?", default="crossing", help="launch file or scene (default: crossing)"
    )
    parser.add_argument("--mode", choices=("realtime", "free", "lockstep"), default="realtime")
    parser.add_argument(
        "--set",
        action="append",
        metavar="KEY=VALUE",
        help=f"as of `launch` (of the crossing: {' '.join(SETTINGS)})",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--write", type=Path, metavar="FILE", help="put the table into this Markdown file")


@dataclass(frozen=True)
class Row:
    """What came of one kill."""

    killed: str
    when: str
    expected: str
    happened: str
    right: bool
    """Whether what happened is what was expected."""
    seconds: float
    limit: float

    @property
    def met(self) -> bool:
        """Whether it was right, and in time."""
        return self.right and self.seconds < self.limit


def run(args: argparse.Namespace) -> int:
    """Kill, one after the other; 1 if anything did not end as it should."""
    rows = []
    settings = args.set or (SETTINGS if args.name == "crossing" else ())
    for row in kills(args.name, args.mode, settings):
        rows.append(row)
        print(f"{row.killed}, {row.when}: {row.happened}, {row.seconds:.2f} s", file=sys.stderr, flush=True)
    met = all(row.met for row in rows)
    if args.json:
        print(json.dumps({"rows": [{**asdict(row), "met": row.met} for row in rows], "all_met": met}))
    else:
        print(markdown(rows))
    if args.write:
        command = " ".join([f"footfall bench kill {args.name} --mode {args.mode}", *set_words(settings)])
        title = f"### SIGKILL of every process (`{command}`)"
        write_section(args.write, f"kill-{args.mode}", f"{title}\n\n{markdown(rows)}")
    return 0 if met else 1


def markdown(rows: list[Row]) -> str:
    """The rows as a table."""
    head = ("killed", "when", "expected", "happened", "after [s]", "limit [s]", "met")
    cells = [(r.killed, r.when, r.expected, r.happened, round(r.seconds, 2), r.limit, r.met) for r in rows]
    return table(head, cells)


def kills(name: str, mode: str, settings: Sequence[str] = ()) -> Iterator[Row]:
    """Kill every node of a graph, then the recorder, the launcher and its watchdog.

    Args:
        name: Launch file or scene.
        mode: How time passes.
        settings: KEY=VALUE, as of `launch --set`.
    """
    given = set_words(settings)
    with Launched(name, mode, arguments=given) as victim:
        nodes = [node.name for node in victim.graph.nodes if node.name != LAUNCHER]
        owner = next(node.name for node in victim.graph.nodes if CLOCK.name in node.outputs)
        yield _required(victim, nodes[0])
    for node in nodes[1:]:
        with Launched(name, mode, arguments=given) as victim:
            yield _required(victim, node)
    restartable = [node for node in nodes if node != owner]
    with Launched(name, mode, restart=restartable, arguments=given) as victim:
        for node in restartable:
            yield restart(victim, node)
    with tempfile.TemporaryDirectory(prefix="ffkill-") as folder:
        log = Path(folder) / "run.mcap"
        with Launched(name, mode, arguments=[*given, "--record", str(log)]) as victim:
            yield _recorder(victim, log)
    with Launched(name, mode, begin=False, arguments=given) as victim:
        victim.wait_for("--node")
        yield _launcher(victim, "nodes are importing")
    with Launched(name, mode, arguments=given) as victim:
        yield _launcher(victim, "mid-run")
    with Launched(name, mode, arguments=given) as victim:
        yield _watchdog(victim)


def _required(victim: Launched, node: str) -> Row:
    begin = victim.kill(f"--node {node}")
    victim.gone()
    seconds = monotonic() - begin
    failure = victim.summary().get("first_failure") or {}
    said = f"{failure.get('node')}: {failure.get('ended')}"
    named = failure.get("node") == node and failure.get("ended") == "killed by SIGKILL"
    code = victim.process.returncode
    return Row(
        node,
        "mid-run",
        "graph stops, first failure named",
        f"exit code {code}, {said}",
        named and code == 1,
        seconds,
        STOP_LIMIT,
    )


def restart(victim: Launched, node: str) -> Row:
    """Kill a node that may be restarted for the first time, and wait for it."""
    begin = victim.kill(f"--node {node}")
    back = victim.first_step(node, life=1)
    seconds = (back or monotonic()) - begin
    return Row(
        node,
        "mid-run, `restart: on-failure`",
        "steps again, the others go on",
        "stepped again" if back else "did not come back",
        back is not None,
        seconds,
        BACK_LIMIT,
    )


def _recorder(victim: Launched, log: Path) -> Row:
    from ..messages.log import LogReader

    sleep(2.0)
    at = victim.next_tick() or 0.0
    victim.kill("--node recorder")
    sleep(1.0)
    victim.next_tick()  # all that has come meanwhile
    goes_on = victim.next_tick() is not None
    victim.process.send_signal(signal.SIGINT)
    victim.gone()
    lost = at - max(logged.stamp_ns for logged in LogReader(log).messages([CLOCK.name])) * 1e-9
    happened = f"the others {'go on' if goes_on else 'stand still'}, log ends {max(lost, 0.0):.2f} s early"
    return Row(
        "recorder", "mid-run", "the others go on, log lacks 1 s", happened, goes_on, max(lost, 0.0), LOG_LIMIT
    )


def _launcher(victim: Launched, when: str) -> Row:
    begin = monotonic()
    victim.process.kill()
    victim.gone()
    seconds = monotonic() - begin
    left = len(victim.survivors())
    return Row(
        LAUNCHER,
        when,
        "no survivor",
        f"{left} survivors" if left else "no survivor",
        not left,
        seconds,
        STOP_LIMIT,
    )


def _watchdog(victim: Launched) -> Row:
    begin = victim.kill("watchdog.py")
    victim.gone()
    seconds = monotonic() - begin
    code = victim.process.returncode
    return Row(
        "launcher's watchdog", "mid-run", "graph stops", f"exit code {code}", code == 1, seconds, STOP_LIMIT
    )
