"""Rollouts of policies as logs: what somebody did, was to do, and was rewarded for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..messages.body import Bodies, BodyStates
from ..messages.graph import Graph, NodeSpec
from ..messages.log import LogError, LogReader, LogWriter
from ..messages.rollout import (
    CUSTOM_TOPICS,
    FOOT_CONTACTS,
    REFERENCE_BODY_STATES,
    REWARD_TERMS,
    ROLLOUT_TOPICS,
    FootContacts,
    RewardTerms,
)
from ..messages.topics import BODIES, BODY_STATES, Topic
from ..models.body import describe
from .motion_take import Take

WRITER = "policy"
"""The one node of a rollout's graph."""


def write_rollout(path: str | Path, takes: Sequence[Take], overwrite: bool = False) -> Path:
    """Write people side by side in time as a log; whose motion is over leaves. Returns its path.

    Args:
        path: The log.
        takes: One a person, all of one rate; their names stand in the log's metadata.
        overwrite: Whether an existing file may be replaced.

    Raises:
        LogError: the file exists or cannot be written.
        ValueError: no take, or several rates.
    """
    if not takes or len({take.rate_hz for take in takes}) > 1:
        raise ValueError("a rollout needs at least one take, and all of one rate")
    topics = ROLLOUT_TOPICS.values()
    graph = Graph(
        "rollout",
        [NodeSpec(WRITER, "footfall.tools.rollout_log", outputs={t.name: t.name for t in topics})],
        custom_topics=CUSTOM_TOPICS,
    )
    names = {"rollout": {str(number): take.name for number, take in enumerate(takes)}}
    counts: dict[str, int] = {}
    with LogWriter(path, graph, names, overwrite=overwrite) as writer:

        def send(topic: Topic, stamp_ns: int, message) -> None:
            sequence = counts[topic.name] = counts.get(topic.name, -1) + 1
            writer.write_message(topic, WRITER, sequence, stamp_ns, sum(counts.values()), message)

        send(BODIES, 0, _bodies(takes))
        for frame in range(max(map(len, takes))):
            there = [number for number, take in enumerate(takes) if frame < len(take)]
            for topic, message in _messages([takes[n] for n in there], np.array(there, np.int32), frame):
                send(topic, round(frame / takes[0].rate_hz * 1e9), message)
    return Path(path)


def _bodies(takes: Sequence[Take]) -> Bodies:
    people = [describe(take.shape) for take in takes]
    return Bodies(
        np.arange(len(takes), dtype=np.int32),
        np.stack([take.shape for take in takes]).astype(np.float32),
        np.array([person.mass for person in people], np.float32),
        np.array([person.stature for person in people], np.float32),
        np.array([person.radius for person in people], np.float32),
        np.stack([person.offsets for person in people]).astype(np.float32),
    )


def _messages(takes: Sequence[Take], ids: np.ndarray, frame: int):
    """Topics and messages of one frame."""
    yield BODY_STATES, BodyStates(ids, np.stack([_full(take.states[frame]) for take in takes]))
    told = [row for row, take in enumerate(takes) if take.reference is not None]
    if told:
        joints = [_full(takes[row].reference[frame]) for row in told]  # type: ignore[index]
        yield REFERENCE_BODY_STATES, BodyStates(ids[told], np.stack(joints))
    judged = [row for row, take in enumerate(takes) if take.terms]
    if judged:
        names = sorted({name for row in judged for name in takes[row].terms})
        values = [[takes[row].terms.get(n, _NONE)[frame] for n in names] for row in judged]
        yield REWARD_TERMS, RewardTerms(ids[judged], names, np.array(values, np.float32))
    stood = [row for row, take in enumerate(takes) if take.contacts is not None]
    if stood:
        wanted = [takes[row].reference_contacts for row in stood]
        reference = None if any(w is None for w in wanted) else np.stack([w[frame] for w in wanted])  # type: ignore[index]
        standing = np.stack([takes[row].contacts[frame] for row in stood])  # type: ignore[index]
        yield FOOT_CONTACTS, FootContacts(ids[stood], standing, reference)


class _Nothing:
    """A term that somebody is not judged by."""

    def __getitem__(self, frame: int) -> float:
        return np.nan


_NONE = _Nothing()


def _full(state: np.ndarray) -> np.ndarray:
    """States (24, 13), with velocities of zero where there are none."""
    return np.pad(state, ((0, 0), (0, 13 - state.shape[1]))).astype(np.float32)


def is_rollout(reader: LogReader) -> bool:
    """Whether a log is a policy's rollout."""
    return bool({REFERENCE_BODY_STATES.name, REWARD_TERMS.name} & set(reader.topics))


def read_rollout(path: str | Path) -> list[Take]:
    """The people of a rollout.

    Raises:
        LogError: not a log, or nobody is in it.
    """
    reader = LogReader(path, ROLLOUT_TOPICS)
    missing = [name for name in (BODIES.name, BODY_STATES.name) if name not in reader.topics]
    if missing:
        raise LogError(f"{path}: has no {' and no '.join(missing)}; a rollout needs both")
    bodies = next(iter(reader.read(BODIES))).message
    columns: dict[tuple[int, str], list[np.ndarray]] = {}
    stamps: dict[int, list[int]] = {}
    names: list[str] = []
    for item in reader.messages(set(ROLLOUT_TOPICS) & set(reader.topics)):
        message = item.message
        for row, agent in enumerate(() if item.topic == BODIES.name else message.ids.tolist()):
            match item.topic:
                case BODY_STATES.name:
                    stamps.setdefault(agent, []).append(item.stamp_ns)
                    values = {"states": message.joints[row]}
                case REFERENCE_BODY_STATES.name:
                    values = {"reference": message.joints[row]}
                case FOOT_CONTACTS.name:
                    values = {"contacts": message.standing[row]}
                    if message.reference is not None:
                        values["reference_contacts"] = message.reference[row]
                case _:
                    names, values = message.names, {"terms": message.values[row]}
            for name, value in values.items():
                columns.setdefault((agent, name), []).append(value)
    if not stamps:
        raise LogError(f"{path}: nobody is in it")
    titles = reader.index.metadata.get("rollout", {})
    takes = []
    for agent, times in sorted(stamps.items()):
        own = {name: np.stack(values) for (who, name), values in columns.items() if who == agent}
        for name, values in own.items():
            if len(values) != len(times):
                raise LogError(f"{path}: person {agent} has {len(times)} states but {len(values)} of {name}")
        terms = own.pop("terms", np.zeros((len(times), 0), np.float32))
        period = (times[-1] - times[0]) * 1e-9 / max(len(times) - 1, 1)
        shape = bodies.shapes[bodies.ids.tolist().index(agent)].astype(np.float64)
        curves = {name: terms[:, column] for column, name in enumerate(names) if terms.size}
        takes.append(
            Take(
                titles.get(str(agent), f"#{agent}"),
                1 / period if period > 0 else 30.0,
                shape,
                own["states"],
                own.get("reference"),
                contacts=own.get("contacts"),
                reference_contacts=own.get("reference_contacts"),
                terms=curves,
                begin=times[0] * 1e-9,
            )
        )
    return takes
