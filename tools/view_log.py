"""A log as pictures: what there was to see at any moment of it."""

from bisect import bisect_right
from collections import OrderedDict
from pathlib import Path
from typing import Any

from ..messages.log import LogError, LogReader
from ..messages.log_reader import Logged
from ..messages.shown_topics import SHOWN, of_kind
from ..messages.topics import AGENTS, BODY_STATES, FALLS
from ..nodes.viewer_picture import FALL_SHOWN, Picture
from ..nodes.viewer_trails import Trails

STREAMS, STATES = of_kind("stream"), of_kind("state")
"""Of which the newest message holds; the streams are read from the file second by second."""
EVENTS = tuple(shown for shown in SHOWN if shown.kind == "event" and shown.recent)
"""Of which several messages are shown."""
SECONDS_KEPT = 20
"""Seconds of the log held in memory."""
LOOK_BACK = 30
"""How old the newest message of a stream may be [s]."""
_SECOND = 1_000_000_000


class LogPictures:
    """Random access to what a log shows.

    Raises:
        LogError: not a log, or one in which there is nobody to see.
    """

    def __init__(self, path: str | Path) -> None:
        self.reader = LogReader(path)
        there = set(self.reader.topics)
        if not {AGENTS.name, BODY_STATES.name} & there:
            raise LogError(f"{path}: nobody is in it; record `agents` or `body_states` to look at a run")
        self.streams = {topic.name for topic in STREAMS} & there
        first, last = self.reader.span_ns
        self.start, self.end = first * 1e-9, last * 1e-9
        self.picture = Picture()
        self._seconds: OrderedDict[int, dict[str, list[Logged[Any]]]] = OrderedDict()
        self._shown: dict[str, tuple[int, int] | None] = {}
        self._small: dict[str, list[Logged[Any]]] = {
            topic.name: [] for topic in (*STATES, *(event.topic for event in EVENTS))
        }
        for item in self.reader.messages(set(self._small) & there):
            self._small[item.topic].append(item)
        self._trails: Trails | None = None
        self._stamps = {name: [item.stamp_ns for item in items] for name, items in self._small.items()}

    def show(self, time: float) -> Picture:
        """The picture of a moment [s]: forwards or backwards, near or far."""
        now_ns = round(time * 1e9)
        picture = self.picture
        picture.now_ns = now_ns
        for topic in (*STATES, *STREAMS):
            item = self._newest(topic.name, now_ns)
            key = None if item is None else (item.stamp_ns, item.sequence)
            if self._shown.get(topic.name) == key:
                continue
            self._shown[topic.name] = key
            if item is None:
                picture.forget(topic.name)
            else:
                picture.take(topic.name, item.message, item.stamp_ns)
        self._show_events(now_ns)
        return picture

    def trails(self) -> Trails:
        """Where everybody walks in the whole run; reads it all the first time."""
        if self._trails is None:
            self._trails = Trails()
            if AGENTS.name in self.reader.topics:
                for item in self.reader.read(AGENTS):
                    self._trails.take(item.message, item.stamp_ns)
        return self._trails

    def _newest(self, topic: str, now_ns: int) -> Logged[Any] | None:
        """The last message of a topic up to a time."""
        if topic in self._small:
            index = bisect_right(self._stamps[topic], now_ns)
            return self._small[topic][index - 1] if index else None
        if topic not in self.streams:
            return None
        second = now_ns // _SECOND
        for number in range(second, max(-1, second - LOOK_BACK), -1):
            items = self._second(number).get(topic, [])
            index = bisect_right(items, now_ns, key=lambda item: item.stamp_ns)
            if index:
                return items[index - 1]
        return None

    def _second(self, number: int) -> dict[str, list[Logged[Any]]]:
        """The streams of one second, in the order of their stamps."""
        found = self._seconds.get(number)
        if found is None:
            found = {}
            start_ns = number * _SECOND
            for item in self.reader.messages(self.streams, start_ns=start_ns, end_ns=start_ns + _SECOND):
                found.setdefault(item.topic, []).append(item)
            self._seconds[number] = found
            if len(self._seconds) > SECONDS_KEPT:
                self._seconds.popitem(last=False)
        self._seconds.move_to_end(number)
        return found

    def _show_events(self, now_ns: int) -> None:
        names = [event.topic.name for event in EVENTS]
        counts = {name: bisect_right(self._stamps[name], now_ns) for name in names}
        key = (hash(tuple(counts.values())), 0)
        if self._shown.get("events") == key:
            return
        self._shown["events"] = key
        picture = self.picture
        picture.falls, picture.reports, picture.methods = [], {}, {}
        picture.lines.clear()
        for event in EVENTS:
            name = event.topic.name
            for item in self._small[name][max(0, counts[name] - event.recent) : counts[name]]:
                if event.topic is not FALLS or now_ns - item.stamp_ns <= FALL_SHOWN * 1e9:
                    picture.take(name, item.message, item.stamp_ns)
