"""The layers of a place as a picture of its ground: smooth edges, asphalt, slabs and grass."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

BARE = (136, 132, 124)
LAYER_COLOURS: dict[str, tuple[int, int, int]] = {
    "walkable": (199, 194, 183),
    "road": (104, 108, 114),
    "pavement": (197, 190, 175),
    "green": (133, 164, 103),
    "stairs": (181, 160, 130),
    "crosswalk": (116, 120, 125),
    "marking": (238, 235, 226),
}
"""Colours of the ground, sRGB, painted in this order."""
_GRAIN = {"road": 0.05, "crosswalk": 0.05, "green": 0.10, "walkable": 0.025, "pavement": 0.025}
"""How much the brightness varies from spot to spot."""
_SLABBED = ("walkable", "pavement")
_SLAB = 1.0  # m between the joints of slabs
_JOINT = 0.90  # brightness of a joint


def paint(
    layers: Mapping[str, ArrayLike], resolution: float, times: int = 4, grain: bool = True
) -> NDArray[np.uint8]:
    """Paint the ground.

    Args:
        layers: raster (H, W) by name, not zero where the layer is; at least one; others than `LAYER_COLOURS` are left
            out.
        resolution: m per cell.
        times: pixels per cell; more than one rounds the edges of cells.
        grain: whether surfaces show their material; a picture without it packs into far fewer bytes.

    Returns:
        (times H, times W, 3) sRGB; rows and columns in the order of the rasters.
    """
    masks = {name: np.asarray(layers[name]) > 0 for name in LAYER_COLOURS if name in layers}
    rows, columns = (times * side for side in np.shape(next(iter(layers.values()))))
    image = np.full((rows, columns, 3), BARE, dtype=np.float32)
    speckle = _speckle(rows, columns) if grain else None
    joints = _joints(rows, columns, _SLAB * times / resolution) if grain else None
    for name, mask in masks.items():
        cover = _cover(mask, times)[..., None]
        if not cover.any():
            continue
        surface = np.array(LAYER_COLOURS[name], dtype=np.float32)
        if speckle is not None:
            surface = surface * (1 + _GRAIN.get(name, 0.0) * speckle)
            if joints is not None and name in _SLABBED:
                surface = surface * joints
        image += cover * (surface - image)
    return np.clip(image.round(), 0, 255).astype(np.uint8)


def _cover(mask: NDArray[np.bool_], times: int) -> NDArray[np.float32]:
    """How much of each pixel a layer covers, with rounded outlines instead of the cells' steps."""
    fine = mask.repeat(times, 0).repeat(times, 1).astype(np.float32)
    if times == 1:
        return fine
    for _ in range(2):
        fine = _blurred(_blurred(fine, times).T, times).T
    return np.clip((fine - 0.5) * times + 0.5, 0, 1, dtype=np.float32)


def _blurred(image: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Means over 2 `reach` + 1 rows, at the rim over those there are."""
    padded = np.pad(image, ((reach + 1, reach), (0, 0)), mode="edge")
    total = padded.cumsum(axis=0, dtype=np.float32)
    return (total[2 * reach + 1 :] - total[: -2 * reach - 1]) * np.float32(1 / (2 * reach + 1))


def _speckle(rows: int, columns: int) -> NDArray[np.float32]:
    """Brightness (rows, columns, 1) about zero: fine dots and wide stains."""
    draw = np.random.default_rng(0)
    dots = draw.uniform(-0.5, 0.5, (rows, columns)).astype(np.float32)
    coarse = draw.uniform(-1, 1, (rows // 24 + 2, columns // 24 + 2)).astype(np.float32)
    stains = coarse.repeat(24, 0).repeat(24, 1)[:rows, :columns]
    for _ in range(2):
        stains = _blurred(_blurred(stains, 12).T, 12).T
    return (dots + stains)[..., None]


def _joints(rows: int, columns: int, period: float) -> NDArray[np.float32]:
    """Brightness (rows, columns, 1) of a grid of joints every `period` pixels."""
    row, column = ((np.arange(side) % period) < 1 for side in (rows, columns))
    return np.where(row[:, None] | column, _JOINT, 1.0).astype(np.float32)[..., None]
