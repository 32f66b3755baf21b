"""Chooses where episodes start: few clips at first, then more, and more often where tracking fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..motion.library import MotionLibrary

_UNIFORM = 0.3  # share of starts that ignores failures
_MEMORY = 0.995  # of the failure rates, per episode of a bin
_RECENT = 2000  # episodes over which the share that fails is judged
_EASY_SPEED = 1.25  # m/s
_BIN = 1 / 3  # s


class ClipSampler:
    """Draws clips and start frames from a library.

    Clips are cut into bins of a third of a second. A bin's chance is its clip's weight times the failure rate of
    episodes that began there, mixed with its weight alone: what is lost at the end of a clip was often lost by
    its first steps, and who begins near the end never meets it. Clips join in the order of their distance from a
    straight walk at ordinary speed.

    Args:
        library: the clips.
        narrow_start: how many clips to begin with.
        widen_below: share of failing episodes below which half as many again join.
        shortest: frames an episode must be able to last.
    """

    def __init__(
        self, library: MotionLibrary, narrow_start: int = 8, widen_below: float = 0.2, shortest: int = 8
    ):
        self.library = library
        self.widen_below = widen_below
        self.shortest = shortest
        strangeness = np.abs(library.speeds - _EASY_SPEED) / 0.5 + np.degrees(np.abs(library.turn_rates)) / 20
        self._order = np.argsort(strangeness, kind="stable")
        self.active = min(narrow_start, len(library))
        """How many clips are in use."""
        self._width = max(round(library.rate_hz * _BIN), 1)
        bins = -(-library.lengths // self._width)
        self._bin_start = np.concatenate([[0], np.cumsum(bins)])[:-1]
        self._clip_of_bin = np.repeat(np.arange(len(library)), bins)
        self._share = np.repeat(library.weights() / bins, bins)
        self.fail_rates: NDArray[np.float64] = np.ones(int(bins.sum()))
        """(bins,) running share of the episodes begun there that failed."""
        self.recent_failures = 1.0
        """Running share of episodes that fail, over all active clips."""
        self._since_widening = 0
        self._distribution = self._probabilities()

    def sample(self, count: int, rng: np.random.Generator) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Draw clips (n,) and start frames (n,) within the clips."""
        library = self.library
        drawn = np.searchsorted(self._distribution, rng.random(count), side="right")
        clips = self._clip_of_bin[drawn]
        within = (rng.random(count) * self._width).astype(int)
        frames = (drawn - self._bin_start[clips]) * self._width + within
        last = np.maximum(library.lengths[clips] - self.shortest, 1)
        return clips, np.where(frames < last, frames, (rng.random(count) * last).astype(int))

    def report(self, clips: NDArray[np.intp], frames: NDArray[np.intp], failed: NDArray[np.bool_]) -> None:
        """Tell how episodes (n,) ended: of which clip, begun at which of its frames, whether in failure."""
        if not len(clips):
            return
        bins = self._bin_start[clips] + frames // self._width
        hits = np.bincount(bins, minlength=len(self.fail_rates))
        failures = np.bincount(bins, failed.astype(float), minlength=len(self.fail_rates))
        keep = _MEMORY ** (20 * hits)
        mean = np.divide(failures, hits, out=np.zeros_like(failures), where=hits > 0)
        self.fail_rates = keep * self.fail_rates + (1 - keep) * mean
        weight = min(len(clips) / _RECENT, 1.0)
        self.recent_failures += weight * (float(failed.mean()) - self.recent_failures)
        self._since_widening += len(clips)
        if (
            self.recent_failures < self.widen_below
            and self._since_widening > 2 * _RECENT
            and self.active < len(self.library)
        ):
            self.active = min(self.active + max(self.active // 2, 1), len(self.library))
            self._since_widening = 0
        self._distribution = self._probabilities()

    def state(self) -> dict[str, NDArray]:
        """All that resuming needs."""
        return {
            "fail_rates": self.fail_rates.copy(),
            "progress": np.array([self.active, self.recent_failures, self._since_widening], dtype=float),
        }

    def load_state(self, state: dict[str, NDArray]) -> None:
        """Go on from `state`; a library of other clips keeps only how wide it was."""
        active, self.recent_failures, since = (float(v) for v in state["progress"])
        self.active, self._since_widening = min(int(active), len(self.library)), int(since)
        if state["fail_rates"].shape == self.fail_rates.shape:
            self.fail_rates = np.asarray(state["fail_rates"], dtype=float)
        self._distribution = self._probabilities()

    def _probabilities(self) -> NDArray[np.float64]:
        """Cumulative chances of the bins."""
        usable = np.zeros(len(self.library), dtype=bool)
        usable[self._order[: self.active]] = True
        plain = np.where(usable[self._clip_of_bin], self._share, 0.0)
        hard = plain * self.fail_rates
        plain /= plain.sum()
        hard = hard / hard.sum() if hard.sum() > 1e-9 else plain
        chances = np.cumsum(_UNIFORM * plain + (1 - _UNIFORM) * hard)
        return chances / chances[-1]
