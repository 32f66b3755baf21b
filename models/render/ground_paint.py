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
    cells = np.shape(next(iter(layers.values())))
    image = np.full((times * cells[0], times * cells[1], 3), BARE, dtype=np.float32)
    speckle = _speckle(image.shape[0], image.shape[1]) if grain else None
    joints = _joints(image.shape[0], image.shape[1], _SLAB * times / resolution) if grain else None
    for name, mask in masks.items():
        if not mask.any():
            continue
        box = _around(mask)
        cover = _cover(mask[box], times)[..., None]
        part = tuple(slice(times * side.start, times * side.stop) for side in box)
        surface = np.array(LAYER_COLOURS[name], dtype=np.float32)
        if speckle is not None:
            surface = surface * (1 + np.float32(_GRAIN.get(name, 0.0)) * speckle[part])
            if joints is not None and name in _SLABBED:
                surface *= joints[part]
        image[part] += cover * (surface - image[part])
    return np.clip(image.round(), 0, 255).astype(np.uint8)


def _around(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Rows and columns of what is set, and two cells more."""
    spans = (np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0)))
    first, second = (
        slice(max(int(span[0]) - 2, 0), min(int(span[-1]) + 3, size))
        for span, size in zip(spans, mask.shape, strict=True)
    )
    return first, second


def _cover(mask: NDArray[np.bool_], times: int) -> NDArray[np.float32]:
    """How much of each pixel a layer covers, with rounded outlines instead of the cells' steps."""
    soft = mask.astype(np.float32)
    if times == 1:
        return soft
    for _ in range(4):  # each row is mixed with its neighbours, then each column, twice
        padded = np.pad(soft, ((1, 1), (0, 0)), mode="edge")
        soft = (0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]).T.astype(np.float32)
    return np.clip((_finer(soft, times) - 0.5) * (2 * times) + 0.5, 0, 1, dtype=np.float32)


def _finer(coarse: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """The same picture of `times` pixels a cell, bilinear between the middles of cells."""
    for _ in range(2):
        size = len(coarse)
        place = np.clip((np.arange(times * size) + 0.5) / times - 0.5, 0, size - 1)
        low = np.minimum(place.astype(int), max(size - 2, 0))
        share = (place - low).astype(np.float32)[:, None]
        high = np.minimum(low + 1, size - 1)
        mixed = coarse[low] * (1 - share) + coarse[high] * share
        coarse = np.ascontiguousarray(mixed.T, dtype=np.float32)
    return coarse


def _speckle(rows: int, columns: int) -> NDArray[np.float32]:
    """Brightness (rows, columns, 1) about zero: fine dots and wide stains."""
    draw = np.random.default_rng(0)
    dots = draw.random((rows, columns), dtype=np.float32) - np.float32(0.5)
    coarse = draw.uniform(-1, 1, (rows // 24 + 2, columns // 24 + 2)).astype(np.float32)
    return (dots + _finer(coarse, 24)[:rows, :columns])[..., None]


def _joints(rows: int, columns: int, period: float) -> NDArray[np.float32]:
    """Brightness (rows, columns, 1) of a grid of joints every `period` pixels."""
    row, column = ((np.arange(side) % period) < 1 for side in (rows, columns))
    return np.where(row[:, None] | column, _JOINT, 1.0).astype(np.float32)[..., None]
