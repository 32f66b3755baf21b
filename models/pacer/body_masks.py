"""Which bodies of the reference a tracker is told: spatial masks of PACER+ (Wang et al. 2024, sec 3.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..body import BODY_INDEX, BODY_NAMES, N_BODIES

Mask = NDArray[np.bool_]

_LEFT_ARM = [i for name, i in BODY_INDEX.items() if name.startswith("L_") and i > BODY_INDEX["Head"]]
_RIGHT_ARM = [i for name, i in BODY_INDEX.items() if name.startswith("R_") and i > BODY_INDEX["Head"]]
_LEGS = [i for name, i in BODY_INDEX.items() if name.split("_")[-1] in ("Hip", "Knee", "Ankle", "Toe")]
_FEWEST, _MOST = 12, 23  # bodies of a random subset, beside the pelvis


def _mask(bodies: list[int]) -> Mask:
    mask = np.zeros(N_BODIES, dtype=bool)
    mask[[0, *bodies]] = True
    mask.flags.writeable = False
    return mask


WHOLE_BODY: Mask = _mask(list(range(N_BODIES)))
UPPER_BODY: Mask = _mask([i for i in range(N_BODIES) if i not in _LEGS])
LEFT_ARM: Mask = _mask(_LEFT_ARM)
RIGHT_ARM: Mask = _mask(_RIGHT_ARM)
PELVIS_ONLY: Mask = _mask([])
"""Nothing but the pelvis, which is always told: its path."""
MASKS: dict[str, Mask] = {
    "whole": WHOLE_BODY,
    "upper": UPPER_BODY,
    "left_arm": LEFT_ARM,
    "right_arm": RIGHT_ARM,
    "pelvis": PELVIS_ONLY,
}
assert len(BODY_NAMES) == N_BODIES == 24


def sample_masks(count: int, masked: float, rng: np.random.Generator) -> Mask:
    """Draw masks (n, 24).

    Args:
        count: n.
        masked: share of masks that hide anything: half of them random subsets of 12 to 23 bodies, half one
        of the
            named parts.
        rng: random numbers.
    """
    masks = np.ones((count, N_BODIES), dtype=bool)
    hide = np.flatnonzero(rng.random(count) < masked)
    if not len(hide):
        return masks
    kept = rng.integers(_FEWEST, _MOST + 1, size=(len(hide), 1))
    ranks = rng.random((len(hide), N_BODIES - 1)).argsort(1).argsort(1)
    masks[hide, 1:] = ranks < kept
    parts = np.array(list(MASKS.values())[1:])
    named = rng.random(len(hide)) < 0.5
    masks[hide[named]] = parts[rng.integers(len(parts), size=int(named.sum()))]
    return masks
