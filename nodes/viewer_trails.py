"""Where everybody has walked since the beginning, thinned out to what a window can draw."""

from collections import defaultdict

import numpy as np

from ..messages.agents import AgentStates

SPACING = 0.4
"""Distance between the points of a trail that are kept [m]."""
GAP = 3.0
"""Who moves farther between two messages has not walked [m]."""


class Trails:
    """The way of each person, growing message by message."""

    def __init__(self) -> None:
        self._last: dict[int, np.ndarray] = {}
        self._segments: dict[int, list[tuple[np.ndarray, np.ndarray]]] = defaultdict(list)
        self._stamps: dict[int, list[int]] = defaultdict(list)
        self.count = 0
        """Segments in all."""

    def take(self, agents: AgentStates, stamp_ns: int) -> None:
        """Add where people are; whoever is not there begins a new way when they come back."""
        places = agents.now[:, :2].astype(np.float64)
        there = agents.ids.tolist()
        for agent in set(self._last) - set(there):
            del self._last[agent]
        for agent, place in zip(there, places, strict=True):
            last = self._last.get(agent)
            if last is not None:
                moved = float(np.linalg.norm(place - last))
                if moved < SPACING:
                    continue
                if moved < GAP:
                    self._segments[agent].append((last, place))
                    self._stamps[agent].append(stamp_ns)
                    self.count += 1
            self._last[agent] = place

    def until(self, now_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Who walked each segment (K,), and the segments (K, 2, 2) [m], up to a time."""
        ids, segments = [], []
        for agent, own in self._segments.items():
            count = int(np.searchsorted(self._stamps[agent], now_ns, side="right"))
            ids += [agent] * count
            segments += own[:count]
        return np.array(ids, dtype=int), np.array(segments, dtype=np.float64).reshape(-1, 2, 2)
