"""What a run has come to: counts of every topic, score, speed, first failure."""

from typing import Any

import msgspec

from ..messages.diagnostics import Diagnostics, InputStats, OutputStats
from ..messages.score import Score


class Failure(msgspec.Struct, frozen=True):
    """How the first node that failed has failed."""

    node: str
    reason: str
    """Its last word."""
    ended: str = ""
    """Exit code or signal, where its process had ended by then."""
    usage: bool = False
    """A fault of the user's input."""

    @property
    def text(self) -> str:
        """One sentence."""
        text = self.reason if self.reason.startswith(self.node) else f"{self.node}: {self.reason}"
        return f"{text} ({self.ended})" if self.ended and not self.usage else text


class TopicCount(msgspec.Struct):
    """What has become of one topic's messages."""

    sent: int = 0
    bytes: int = 0
    received: dict[str, int] = {}
    """By subscriber."""
    dropped: int = 0
    """Lost on the way, over all subscribers."""
    skipped: int = 0
    """Replaced by newer ones before they were read: what `latest` and `queue` are for."""
    rejected: int = 0
    refused: int = 0
    """Deliveries given up because a reliable subscriber did not take them in time."""


class Summary(msgspec.Struct, frozen=True):
    """The result of a run, as `footfall launch --json` prints it."""

    graph: str
    agents: int | None
    """Pedestrians who have entered; None without a referee."""
    sim_seconds: float
    start_seconds: float
    """From the launcher's start to the moment all nodes are ready."""
    wall_seconds: float
    """From the first tick to the last."""
    real_time_factor: float
    dropped: int
    """Messages lost, over all topics: gaps, and what reliable subscribers did not take."""
    collisions: int | None
    goals_reached: int | None
    falls: int | None
    entered: int | None
    agent_seconds: float | None
    agent_overlap_share: float | None
    """Share of `agent_seconds` in which somebody overlaps somebody else."""
    obstacle_overlap_share: float | None
    track_distance: float | None
    """Mean distance from where the same person was recorded at the same time [m]."""
    topics: dict[str, TopicCount]
    restarts: dict[str, int]
    """Of the nodes that were restarted."""
    first_failure: Failure | None
    ended: str
    """Why the run has ended."""
    signal: int | None
    """Number of the signal that stopped it."""
    log: str | None
    """The recording."""
    run_dir: str
    """Where the nodes' own logs are."""


class Counts:
    """Adds up the diagnostics of all nodes, over their restarts."""

    def __init__(self) -> None:
        self._latest: dict[tuple[str, int], Diagnostics] = {}

    def take(self, message: Diagnostics) -> None:
        """The newest report of a node's process replaces its last one."""
        self._latest[message.node, message.pid] = message

    @property
    def reports(self) -> list[Diagnostics]:
        """The newest report of each process."""
        return list(self._latest.values())

    def topics(self) -> dict[str, TopicCount]:
        """Counts by topic."""
        counts: dict[str, TopicCount] = {}
        for report in self._latest.values():
            for output in report.outputs:
                _add_output(counts.setdefault(output.topic, TopicCount()), output)
            for wire in report.inputs:
                _add_input(counts.setdefault(wire.topic, TopicCount()), report.node, wire)
        return dict(sorted(counts.items()))

    @property
    def dropped(self) -> int:
        """Messages lost so far."""
        return sum(count.dropped + count.refused for count in self.topics().values())


def _add_output(count: TopicCount, output: OutputStats) -> None:
    count.sent += output.sent
    count.bytes += output.bytes
    count.refused += output.refused


def _add_input(count: TopicCount, node: str, wire: InputStats) -> None:
    count.received[node] = count.received.get(node, 0) + wire.received
    count.dropped += wire.dropped
    count.skipped += wire.skipped
    count.rejected += wire.rejected


def score_facts(score: Score | None) -> dict[str, Any]:
    """The fields of a summary that come from the score; None where there is none."""
    if score is None:
        keys = ("agents", "collisions", "goals_reached", "falls", "entered", "agent_seconds")
        return dict.fromkeys((*keys, "agent_overlap_share", "obstacle_overlap_share", "track_distance"))
    seconds = score.agent_seconds
    return {
        "agents": score.entered,
        "collisions": score.collisions,
        "goals_reached": score.goals_reached,
        "falls": score.falls,
        "entered": score.entered,
        "agent_seconds": seconds,
        "agent_overlap_share": score.agent_overlap_seconds / seconds if seconds else 0.0,
        "obstacle_overlap_share": score.obstacle_overlap_seconds / seconds if seconds else 0.0,
        "track_distance": score.track_distance,
    }


def summary_text(summary: Summary) -> str:
    """The summary for people."""
    lines = [
        f"{summary.graph}: {summary.sim_seconds:.1f} s simulated in {summary.wall_seconds:.1f} s"
        f" ({summary.real_time_factor:.1f}x real time); {summary.ended}"
    ]
    if summary.agents is not None:
        scored = [
            f"{summary.agents} agents",
            f"{summary.goals_reached} goals reached",
            f"{summary.collisions} collisions",
            f"{summary.falls} falls",
        ]
        if summary.track_distance is not None:
            scored.append(f"{summary.track_distance:.2f} m from the recorded tracks")
        lines.append(", ".join(scored))
    lost = {
        name: count.dropped + count.refused
        for name, count in summary.topics.items()
        if count.dropped or count.refused
    }
    by_topic = f" ({', '.join(f'{name} {n}' for name, n in lost.items())})" if lost else ""
    lines.append(f"{summary.dropped} messages dropped{by_topic}")
    lines += [f"{node} was restarted {n} times" for node, n in summary.restarts.items()]
    if summary.log:
        lines.append(f"recorded to {summary.log}")
    return "\n".join(lines)
