"""Semantic maps of many scenes as one stack of signed distance fields, sampled at any point and scale."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import distance_transform_edt
from torch import Tensor


@dataclass(frozen=True)
class SceneMaps:
    """Signed distance [m] to each semantic layer, negative inside; beyond the grid its border value holds.

    A distance field is free of resolution: a raster crop at any scale is its sign, and its gradient points
    away from the layer.

    Attributes:
        distance: (S, C, H, W) one field per scene and layer; row index grows with y, column index with x.
        origin: (S, 2) world x, y of the centre of cell (0, 0) [m].
        resolution: Cell size [m].
        layers: Names of the C layers.
    """

    distance: Tensor
    origin: Tensor
    resolution: float
    layers: tuple[str, ...] = ("obstacle",)

    def __post_init__(self):
        if self.distance.ndim != 4 or self.distance.shape[1] != len(self.layers):
            raise ValueError(
                f"SceneMaps: distance must be (scenes, {len(self.layers)} layers, rows, columns), "
                f"not {tuple(self.distance.shape)}"
            )

    @classmethod
    def from_raster(
        cls, layers: dict[str, np.ndarray], resolution: float, origin: Sequence[float] = (0.0, 0.0)
    ) -> "SceneMaps":
        """The map of one scene from boolean layers.

        Args:
            layers: Name to (H, W) bool, true where the property holds; row index grows with y.
            resolution: Cell size [m].
            origin: World x, y of the centre of cell (0, 0) [m].

        Raises:
            ValueError: When layers are no grids of one shape, or resolution or origin are no lengths.
        """
        shapes = {np.shape(mask) for mask in layers.values()}
        if len(shapes) != 1 or len(shape := shapes.pop()) != 2 or 0 in shape:
            raise ValueError(f"the layers {', '.join(layers)} must be grids (H, W) of one shape, with cells")
        if not 0 < resolution < np.inf:
            raise ValueError(f"the resolution of a map must be above 0 m, not {resolution}")
        if np.shape(origin) != (2,) or not np.isfinite(origin).all():
            raise ValueError(f"the origin of a map must be two finite coordinates, not {origin}")
        fields = [signed_distance(np.asarray(mask, bool), resolution) for mask in layers.values()]
        distance = torch.from_numpy(np.stack(fields))[None]
        return cls(distance, torch.tensor([list(origin)], dtype=torch.float32), resolution, tuple(layers))

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Lower left and upper right corner (2,) of what all scenes cover, world [m]."""
        cells = torch.tensor(self.distance.shape[:1:-1])  # columns, rows
        low = self.origin - self.resolution / 2
        return low.amin(0), (low + self.resolution * cells).amax(0)

    def layer(self, name: str) -> "SceneMaps":
        """The same scenes with one layer only.

        Raises:
            ValueError: When no layer has this name.
        """
        return self.select((name,))

    def select(self, names: Sequence[str]) -> "SceneMaps":
        """These layers in this order; `walkable` is what is no obstacle if it was not given.

        Raises:
            ValueError: When a layer is neither present nor implied.
        """
        if tuple(names) == self.layers:
            return self
        fields = []
        for name in names:
            if name in self.layers:
                fields.append(self.distance[:, self.layers.index(name)])
            elif name == "walkable" and "obstacle" in self.layers:
                fields.append(-self.distance[:, self.layers.index("obstacle")])
            else:
                raise ValueError(f"the map has no layer {name!r}; its layers are {', '.join(self.layers)}")
        return SceneMaps(torch.stack(fields, 1), self.origin, self.resolution, tuple(names))

    def sample(self, points: Tensor, scene: Tensor) -> Tensor:
        """Signed distances at world points, bilinear, differentiable in the points.

        Args:
            points: (B, P, 2) world x, y [m].
            scene: (B,) index of the scene of each row.

        Returns:
            (B, P, C) signed distances [m].
        """
        return _read(self._tall, self._grid(points, scene))

    def sample_slopes(self, points: Tensor, scene: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distances (B, P, C) at world points (B, P, 2), and their gradients (B, P, C, 2); without a graph.

        Gradients are bilinear between the central differences at the cells, smoother than those of `sample`; they
        are zero beyond the maps.
        """
        values = _read(self._tall_slopes, self._grid(points.detach(), scene)).unflatten(-1, (-1, 3))
        return values[..., 0], values[..., 1:]

    def _grid(self, points: Tensor, scene: Tensor) -> Tensor:
        """Where world points (B, P, 2) are in the tall picture, as `grid_sample` counts."""
        if len(self.origin) == 1:  # then the picture ends where the map does
            return torch.addcmul(self._offset, points, self._per_metre)
        rows, columns = self.distance.shape[2:]
        cell = (points - self.origin[scene][:, None]) / self.resolution
        x = cell[..., 0].clamp(0, columns - 1)
        y = cell[..., 1].clamp(0, rows - 1) + (scene * rows)[:, None]
        return torch.stack([x, y], -1) * self._scale - 1

    def view(self, pose: Tensor, scene: Tensor) -> "MapView":
        """How agents at poses (B, 3), world x, y [m] and heading, see the maps of their scenes (B,)."""
        cos, sin = pose[:, 2].cos(), pose[:, 2].sin()
        turn = torch.stack([torch.stack([cos, sin], -1), torch.stack([-sin, cos], -1)], -2)
        rows = self.distance.shape[2]
        scale = self._per_metre
        first = torch.stack([torch.zeros_like(scene), scene * rows], -1) * self._scale - 1
        offset = (pose[:, :2] - self.origin[scene]) * scale + first
        low = first[:, 1]
        return MapView(self, turn * scale, offset, low, low + (rows - 1) * self._scale[1])

    @cached_property
    def _tall(self) -> Tensor:
        """(1, C, S * H, W): all scenes in one tall picture, so that one call serves every agent of every scene."""
        scenes, channels, rows, columns = self.distance.shape
        return self.distance.transpose(0, 1).reshape(1, channels, scenes * rows, columns)

    @cached_property
    def _tall_slopes(self) -> Tensor:
        """(1, C * 3, S * H, W): distance and slopes along x and y of every layer."""
        field, twice = self.distance, 2 * self.resolution
        right, up = torch.zeros_like(field), torch.zeros_like(field)  # zero at the border
        right[..., 1:-1, 1:-1] = (field[..., 1:-1, 2:] - field[..., 1:-1, :-2]) / twice
        up[..., 1:-1, 1:-1] = (field[..., 2:, 1:-1] - field[..., :-2, 1:-1]) / twice
        picture = torch.stack([field, right, up], 2)  # (S, C, 3, H, W)
        return picture.flatten(1, 2).transpose(0, 1).flatten(1, 2)[None]

    @cached_property
    def _per_metre(self) -> Tensor:
        """(2,) from metres to twice the share of the tall picture."""
        return self._scale / self.resolution

    @cached_property
    def _offset(self) -> Tensor:
        """(1, 2) where the world's origin is in the picture of a single scene."""
        return -self.origin * self._scale / self.resolution - 1

    @cached_property
    def _scale(self) -> Tensor:
        """(2,) from columns and rows of the tall picture to twice the share of it."""
        rows, columns = self._tall.shape[2:]
        return 2 / torch.tensor([max(columns - 1, 1), max(rows - 1, 1)])


@dataclass(frozen=True)
class MapView:
    """Maps as B agents see them: their own frames straight to the picture, for who looks up many points often.

    Attributes:
        maps: What they look at.
        turn: (B, 2, 2) from metres ahead and left to the picture.
        offset: (B, 2) where they are in it.
        low: (B,) first row of their scene.
        high: (B,) its last row.
    """

    maps: SceneMaps
    turn: Tensor
    offset: Tensor
    low: Tensor
    high: Tensor

    def repeat(self, samples: int) -> "MapView":
        """Every agent `samples` times in a row."""
        parts = (self.turn, self.offset, self.low, self.high)
        return MapView(self.maps, *(part.repeat_interleave(samples, 0) for part in parts))

    def around(self, positions: Tensor, star: Tensor) -> Tensor:
        """`SceneMaps.sample` around ego-frame positions (B, T, 2) at offsets (P, 2) [m], as (B, T * P, C)."""
        ahead, left = (
            self.turn[:, None, 0],
            self.turn[:, None, 1],
        )  # two products are faster than 2 x 2 matrices
        middle = torch.addcmul(self.offset[:, None], positions[..., :1], ahead)
        middle = torch.addcmul(middle, positions[..., 1:], left)
        grid = (middle[:, :, None] + (star[:, :1] * ahead + star[:, 1:] * left)[:, None]).flatten(1, 2)
        if len(self.maps.origin) > 1:  # another scene goes on where this one ends
            rows = grid[..., 1].clamp(self.low[:, None], self.high[:, None])
            grid = torch.stack([grid[..., 0], rows], -1)
        return _read(self.maps._tall, grid)


def _read(picture: Tensor, grid: Tensor) -> Tensor:
    """Values (B, P, C) of a picture (1, C, H, W) at places (B, P, 2), as `grid_sample` counts them."""
    values = F.grid_sample(picture, grid[None], mode="bilinear", padding_mode="border", align_corners=True)
    return values[0].permute(1, 2, 0)


def signed_distance(mask: np.ndarray, resolution: float) -> np.ndarray:
    """Distance [m] of every cell centre to the border of a (H, W) bool mask, negative inside, float32.

    The border runs half-way between neighbouring cell centres; a uniform mask is `far` from its border
    everywhere.
    """
    far = np.float32(resolution * np.hypot(*mask.shape))
    if not mask.any():
        return np.full(mask.shape, far, np.float32)
    if mask.all():
        return np.full(mask.shape, -far, np.float32)
    outside = np.asarray(distance_transform_edt(~mask))
    inside = np.asarray(distance_transform_edt(mask))
    return (resolution * np.where(mask, 0.5 - inside, outside - 0.5)).astype(np.float32)


def polygon_distance(points: np.ndarray, polygons: Sequence[np.ndarray]) -> np.ndarray:
    """Signed distance [m] of points (P, 2) to a union of convex polygons, each (V, 2), negative inside.

    Exact outside; inside overlapping polygons it is the depth in the deepest one. Without polygons it is 1e3.
    """
    nearest = np.full(len(points), 1e3, np.float32)
    for polygon in polygons:
        start = np.asarray(polygon, np.float32)
        edge = np.roll(start, -1, 0) - start
        winding = np.sign(
            (start[:, 0] * np.roll(start, -1, 0)[:, 1] - start[:, 1] * np.roll(start, -1, 0)[:, 0]).sum()
        )
        square = np.full(len(points), np.inf, np.float32)
        inside = np.ones(len(points), bool)
        for (ax, ay), (ex, ey) in zip(start, edge, strict=True):
            px, py = points[:, 0] - ax, points[:, 1] - ay
            t = np.clip((px * ex + py * ey) / max(ex * ex + ey * ey, 1e-12), 0, 1)
            square = np.minimum(square, (px - t * ex) ** 2 + (py - t * ey) ** 2)
            inside &= (ex * py - ey * px) * winding >= 0
        nearest = np.minimum(nearest, np.where(inside, -1, 1) * np.sqrt(square))
    return nearest.astype(np.float32)
