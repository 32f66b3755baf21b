"""Shortest ways around static obstacles on a grid, and the velocity that follows them."""

from collections import OrderedDict
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from .grid_graph import WayTree, grid_graph, way_tree

Array = NDArray[np.float64]
Index = NDArray[np.intp]

LOOK_AHEAD = 64  # cells along the grid way among which the farthest visible one is sought
DETOUR = 1.03  # a straight line may cost so much more than the grid way; covers the error of 16 directions
ARRIVAL_TIME = 0.4  # s; speed is at most distance / ARRIVAL_TIME, so shorter steps never overshoot
CACHED_TREES = 128


class NavigationError(ValueError):
    """A grid, place or speed cannot be navigated."""


class ResolvedGoals(NamedTuple):
    """Places that can be reached instead of the wanted ones."""

    goal: Array
    """(n, 2) m: the wanted goal, or the middle of the nearest cell that can be reached."""
    moved: NDArray[np.bool_]
    """(n,) whether the wanted goal could not be reached."""


class Navigator:
    """Leads discs around the obstacles of a grid.

    Ways are shortest in a graph of 16 directions (Dijkstra) and pulled straight while walking: the next way
    point is the farthest cell of the way that is in sight. Trees of ways are cached by goal cell.
    """

    def __init__(
        self,
        blocked: NDArray[np.bool_],
        resolution: float,
        origin: ArrayLike,
        clearance: float,
        cost: ArrayLike | None = None,
    ) -> None:
        """Prepare the graph.

        Args:
            blocked: (H, W) cells that hold an obstacle; row index grows with y.
            resolution: edge of a cell, m.
            origin: world x, y of the outer corner of cell [0, 0], m.
            clearance: least distance of a way to obstacles, m (the body radius).
            cost: (H, W) cost of a metre, above zero; 1 everywhere unless given.

        Raises:
            NavigationError: a shape or number is out of range, or clearance leaves no free cell.
        """
        blocked = np.asarray(blocked, dtype=bool)
        if blocked.ndim != 2 or not blocked.size:
            raise NavigationError(f"blocked has shape {blocked.shape}; a grid (H, W) is needed")
        if not 0 < resolution < np.inf:
            raise NavigationError(f"resolution is {resolution} m; a size above zero is needed")
        if not 0 <= clearance < np.inf:
            raise NavigationError(f"clearance is {clearance} m; a distance not below zero is needed")
        self._shape = blocked.shape
        self._resolution = float(resolution)
        self._origin = np.asarray(origin, dtype=np.float64)
        if self._origin.shape != (2,) or not np.isfinite(self._origin).all():
            raise NavigationError(f"origin is {origin}; two finite coordinates are needed")
        self._uniform = cost is None
        self._cost = np.ones(self._shape) if cost is None else np.asarray(cost, dtype=np.float64)
        if self._cost.shape != self._shape or not 0 < self._cost.min() <= self._cost.max() < np.inf:
            raise NavigationError(f"cost must be finite and above zero, with the grid's shape {self._shape}")
        self._free = ~blocked
        if blocked.any():  # from the middle of a cell to the edge of the nearest blocked one
            distance = np.asarray(ndimage.distance_transform_edt(~blocked), dtype=np.float64) - 0.5
            self._free &= distance * resolution >= clearance - 1e-9
        if not self._free.any():
            raise NavigationError(f"a clearance of {clearance} m leaves no free cell in the grid")
        parts = np.empty(self._shape, dtype=np.int32)  # 0 is blocked; parts are 4-connected
        ndimage.label(self._free, output=parts)
        self._part = parts.ravel()
        index = np.empty((2, *self._shape), dtype=np.int32)
        ndimage.distance_transform_edt(~self._free, None, False, True, indices=index)
        self._nearest_free = (index[0].astype(np.intp) * self._shape[1] + index[1]).ravel()
        self._graph = grid_graph(self._free, self._cost, self._resolution)
        self._trees: OrderedDict[int, WayTree] = OrderedDict()
        self._stand_ins: dict[tuple[int, int], int] = {}

    def preferred_velocity(self, xy: ArrayLike, goal: ArrayLike, speed: ArrayLike) -> Array:
        """Velocity (n, 2) along the shortest ways, m/s.

        It leads straight to the goal when that is in sight (and, with a cost layer, not dearer than the way),
        otherwise to the farthest point in sight on the way, and falls to zero at the goal.

        Args:
            xy: (n, 2) places, world frame, m; off the grid or too near an obstacle the nearest free cell
                counts.
            goal: (n, 2) m; see `resolve`.
            speed: (n,) walking speed, m/s.

        Raises:
            NavigationError: shapes disagree or a number is not finite.
        """
        xy, goal = _points(xy, goal)
        speed = np.asarray(speed, dtype=np.float64)
        if speed.shape not in ((), (len(xy),)) or not np.isfinite(speed).all():
            raise NavigationError(f"speed has shape {speed.shape}; ({len(xy)},) finite numbers are needed")
        target, is_goal = self._targets(xy, self.resolve(xy, goal).goal)
        arm = target - xy
        distance = np.hypot(arm[:, 0], arm[:, 1])
        speed = np.where(is_goal, np.minimum(speed, distance / ARRIVAL_TIME), speed)
        return arm * (speed / np.maximum(distance, 1e-9))[:, None]

    def resolve(self, xy: ArrayLike, goal: ArrayLike) -> ResolvedGoals:
        """Replace goals (n, 2) that are blocked or cut off from `xy` (n, 2) by the nearest cell in reach."""
        xy, goal = _points(xy, goal)
        part, cell = self._part[self._start_cells(xy)], self._cells(goal)
        far_corner = self._origin + self._resolution * np.array(self._shape[::-1])
        outside = np.any((goal < self._origin) | (goal > far_corner), axis=1)
        moved = (self._part[cell] != part) | outside
        resolved = goal.copy()
        for k in np.flatnonzero(moved):
            resolved[k] = self._middle(self._stand_in(int(part[k]), int(cell[k])))
        return ResolvedGoals(resolved, moved)

    def distance(self, xy: ArrayLike, goal: ArrayLike) -> Array:
        """Length (n,) of the way from each place to its resolved goal, m; a cost layer weighs it."""
        xy, goal = _points(xy, goal)
        goal = self.resolve(xy, goal).goal
        start, end = self._start_cells(xy), self._cells(goal)
        seen, straight = self._sight(xy, goal)
        length = straight.copy()
        for k in np.flatnonzero(~seen) if self._uniform else range(len(xy)):
            length[k] = self._tree(int(end[k])).cost[start[k]]
        return np.where(seen & self._worth(straight, length, start), straight, length)

    def path(self, xy: ArrayLike, goal: ArrayLike) -> Array:
        """Corner points (K, 2) of the straightened way from a place (2,) to its goal, both included."""
        here, end = _points(np.reshape(xy, (1, -1)), np.reshape(goal, (1, -1)))
        end = self.resolve(here, end).goal
        points = [here[0]]
        for _ in range(self._free.size):
            here, is_goal = self._targets(here, end)
            points.append(here[0])
            if is_goal[0]:
                break
        return np.array(points)

    def _targets(self, xy: Array, goal: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Next way point (n, 2) for each place, and whether it is the goal."""
        start, end = self._start_cells(xy), self._cells(goal)
        seen, straight = self._sight(xy, goal)
        direct = start == end
        if self._uniform:
            direct |= seen
        target = goal.copy()
        for cell in np.unique(end[~direct]):
            rows = np.flatnonzero((end == cell) & ~direct)
            tree = self._tree(int(cell))
            worth = seen[rows] & self._worth(straight[rows], tree.cost[start[rows]], start[rows])
            direct[rows[worth]] = True
            rows = rows[~worth]
            if rows.size:
                target[rows] = self._farthest_in_sight(xy[rows], start[rows], tree)
        return target, direct

    def _farthest_in_sight(self, xy: Array, start: Index, tree: WayTree) -> Array:
        """Bisect for the farthest of the next `LOOK_AHEAD` cells that a straight line reaches as cheaply."""
        chain = np.empty((LOOK_AHEAD + 1, len(start)), dtype=np.intp)
        chain[0] = start
        for k in range(LOOK_AHEAD):
            chain[k + 1] = tree.following[chain[k]]
        row = np.arange(len(start))
        near, far = np.ones(len(start), dtype=np.intp), np.full(len(start), LOOK_AHEAD + 1)
        while (far - near > 1).any():
            middle = (near + far) // 2
            cell = chain[middle, row]
            seen, straight = self._sight(xy, self._middle(cell))
            seen &= self._worth(straight, tree.cost[start] - tree.cost[cell], start)
            near, far = np.where(seen, middle, near), np.where(seen, far, middle)
        return self._middle(chain[near, row])

    def _sight(self, xy: Array, target: Array) -> tuple[NDArray[np.bool_], Array]:
        """Whether straight lines (n, 2) to (n, 2) stay free, sampled twice a cell, and what they cost.

        A line may begin in cells that are too near an obstacle, since bodies brush past corners.
        """
        arm = target - xy
        length = np.hypot(arm[:, 0], arm[:, 1])
        samples = int(np.ceil(2 * length.max(initial=0.0) / self._resolution)) + 1
        fraction = (np.arange(samples) + 0.5) / samples
        cells = self._cells(xy[:, None] + fraction[:, None] * arm[:, None])  # (n, S)
        free = self._free.ravel()[cells]
        brushing = ~np.maximum.accumulate(free, axis=1) & (fraction * length[:, None] < 2 * self._resolution)
        seen = (free | brushing).all(axis=1) & self._free.ravel()[self._cells(target)]
        return seen, length if self._uniform else length * self._cost.ravel()[cells].mean(axis=1)

    def _worth(self, straight: Array, along: NDArray[np.floating], start: Index) -> NDArray[np.bool_]:
        """Whether straight lines cost hardly more than ways on the grid from their start cells."""
        if self._uniform:
            return np.ones(len(start), bool)
        return straight <= DETOUR * along + self._resolution * self._cost.ravel()[start]

    def _tree(self, cell: int) -> WayTree:
        """Tree of shortest ways to a cell, from the cache if it was used lately."""
        if cell not in self._trees:
            self._trees[cell] = way_tree(self._graph, cell)
        self._trees.move_to_end(cell)
        if len(self._trees) > CACHED_TREES:
            self._trees.popitem(last=False)
        return self._trees[cell]

    def _stand_in(self, part: int, cell: int) -> int:
        """Cell of a connected part nearest to a cell outside it."""
        if (part, cell) not in self._stand_ins:
            members = np.flatnonzero(self._part == part)
            arm = self._middle(members) - self._middle(cell)
            self._stand_ins[part, cell] = int(members[(arm**2).sum(axis=1).argmin()])
        return self._stand_ins[part, cell]

    def _cells(self, xy: Array) -> Index:
        """Flat index (...,) of the cell that holds each point (..., 2), or of the nearest to one outside."""
        place = np.floor((xy - self._origin) / self._resolution).astype(np.intp)
        column = np.minimum(np.maximum(place[..., 0], 0), self._shape[1] - 1)
        return np.minimum(np.maximum(place[..., 1], 0), self._shape[0] - 1) * self._shape[1] + column

    def _start_cells(self, xy: Array) -> Index:
        """Free cell nearest to the cell of each point."""
        return self._nearest_free[self._cells(xy)]

    def _middle(self, cell: Index | int) -> Array:
        """World coordinates (..., 2) of the middle of cells."""
        row, column = np.divmod(cell, self._shape[1])
        return self._origin + self._resolution * (np.stack((column, row), axis=-1) + 0.5)


def _points(xy: ArrayLike, goal: ArrayLike) -> tuple[Array, Array]:
    """Check places and goals."""
    xy, goal = np.asarray(xy, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    if xy.ndim != 2 or xy.shape[1] != 2 or xy.shape != goal.shape:
        raise NavigationError(f"places and goals must both be (n, 2), not {xy.shape} and {goal.shape}")
    if not (np.isfinite(xy).all() and np.isfinite(goal).all()):
        raise NavigationError("a place or goal is not finite")
    return xy, goal
