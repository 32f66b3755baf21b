"""Shortest ways on a grid of cells, in 16 directions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

Array = NDArray[np.float64]


class WayTree(NamedTuple):
    """Shortest ways from every cell to one goal cell; cells are numbered row by row."""

    cost: NDArray[np.float32]
    """(H W,) m times cost factor; infinite where there is no way."""
    following: NDArray[np.int32]
    """(H W,) next cell towards the goal; the goal follows itself, a cell without a way has -9999."""


def way_tree(graph: csr_array, cell: int) -> WayTree:
    """Dijkstra from the goal outwards; `graph` comes from `grid_graph`."""
    cost, following = dijkstra(graph, indices=cell, return_predecessors=True)
    following[cell] = cell
    return WayTree(cost.astype(np.float32), following)


def grid_graph(free: NDArray[np.bool_], cost: Array, resolution: float) -> csr_array:
    """Edges between free cells whose brushed cells are free as well, so that no way cuts a corner.

    A way is at most 2.8 % longer than the straight line (1 / cos of half the angle between two directions).

    Args:
        free: (H, W) cells that can be entered.
        cost: (H, W) cost of a metre.
        resolution: edge of a cell, m.

    Returns:
        (H W, H W) symmetric matrix of costs; cells are numbered row by row.
    """
    height, width = free.shape
    index = np.arange(free.size).reshape(free.shape)
    beginnings, ends, lengths = [], [], []

    def shifted(array: NDArray, dy: int, dx: int, rows: slice, columns: slice) -> NDArray:
        return array[rows.start + dy : rows.stop + dy, columns.start + dx : columns.stop + dx]

    for dy, dx, brushed in _MOVES:
        rows = slice(max(0, -dy), height - max(0, dy))
        columns = slice(max(0, -dx), width - max(0, dx))
        if rows.start >= rows.stop or columns.start >= columns.stop:
            continue
        passable = free[rows, columns] & shifted(free, dy, dx, rows, columns)
        for by, bx in brushed:
            passable &= shifted(free, by, bx, rows, columns)
        mean = (cost[rows, columns] + shifted(cost, dy, dx, rows, columns)) / 2
        beginnings.append(index[rows, columns][passable])
        ends.append(beginnings[-1] + dy * width + dx)
        lengths.append(mean[passable] * (resolution * np.hypot(dy, dx)))
    edges = (np.concatenate(beginnings), np.concatenate(ends)) if beginnings else (np.zeros(0, int),) * 2
    return csr_array((np.concatenate(lengths or [np.zeros(0)]), edges), shape=(free.size, free.size))


def _moves() -> list[tuple[int, int, list[tuple[int, int]]]]:
    """The 16 moves (dy, dx) with the cells between that must be free."""
    moves: list[tuple[int, int, list[tuple[int, int]]]] = []
    for s in (1, -1):
        moves += [(s, 0, []), (0, s, [])]
        for t in (1, -1):
            moves.append((s, t, [(s, 0), (0, t)]))
            moves.append((s, 2 * t, [(0, t), (s, t)]))
            moves.append((2 * s, t, [(s, 0), (s, t)]))
    return moves


_MOVES = _moves()
