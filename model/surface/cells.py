"""Points sorted into the cells of a regular grid: who is near, without a tree."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from model.compiled import compiled

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Cells of a cloud whose points are few and far between would outnumber the points.
_MOST_CELLS = 2_000_000


class Cells(NamedTuple):
    """A cloud in cell order.

    Attributes:
        points: (N, 3), cell by cell.
        order: (N,) the given row of each.
        low: (3,) corner of the grid.
        shape: (3,) cells along each axis.
        start: (cells + 1,) where each cell's points begin.
        size: edge of a cell; all points within it of a position lie in the 27 cells around.
    """

    points: FloatArray
    order: IntArray
    low: FloatArray
    shape: IntArray
    start: IntArray
    size: float


def cells_of(points: FloatArray, size: float) -> Cells:
    """Sort points (N, 3) into cells of at least this size."""
    low = points.min(axis=0)
    extent = points.max(axis=0) - low
    while True:
        shape = (extent / size).astype(np.int64) + 1
        if math.prod(shape.tolist()) <= _MOST_CELLS:
            break
        size *= 1.5
    inside, order, start = _sorted(points, low, shape, float(size))
    return Cells(inside, order, low, shape, start, float(size))


@compiled
def _sorted(
    points: FloatArray, low: FloatArray, shape: IntArray, size: float
) -> tuple[FloatArray, IntArray, IntArray]:
    """Points (N, 3) cell by cell, the row of each, and where each cell begins."""
    cell = np.empty(len(points), np.int64)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for i in range(len(points)):
        flat = 0
        for a in range(3):
            flat = flat * shape[a] + min(int((points[i, a] - low[a]) / size), shape[a] - 1)
        cell[i] = flat
        start[flat + 1] += 1
    for c in range(1, len(start)):
        start[c] += start[c - 1]
    inside, order, free = np.empty((len(points), 3)), np.empty(len(points), np.int64), start.copy()
    for i in range(len(points)):
        at = free[cell[i]]
        free[cell[i]] = at + 1
        order[at] = i
        for a in range(3):
            inside[at, a] = points[i, a]
    return inside, order, start


@compiled
def runs_around(cells: Cells, y0: float, y1: float, y2: float, runs: IntArray) -> int:
    """Runs of points in the 27 cells around a position; at most 9, as z is contiguous.

    Args:
        cells: of the cloud.
        y0: the position's x; y1, y2 likewise.
        y1: see ``y0``.
        y2: see ``y0``.
        runs: (9, 2) is filled with the first and past-the-last row of each run.

    Returns:
        how many runs there are.
    """
    shape = cells.shape
    q0 = math.floor((y0 - cells.low[0]) / cells.size)
    q1 = math.floor((y1 - cells.low[1]) / cells.size)
    q2 = math.floor((y2 - cells.low[2]) / cells.size)
    first, last = max(0, q2 - 1), min(shape[2] - 1, q2 + 1)
    count = 0
    if last < first:
        return 0
    for u in range(max(0, q0 - 1), min(shape[0], q0 + 2)):
        for v in range(max(0, q1 - 1), min(shape[1], q1 + 2)):
            row = (u * shape[1] + v) * shape[2]
            a, b = cells.start[row + first], cells.start[row + last + 1]
            if b > a:
                runs[count, 0], runs[count, 1] = a, b
                count += 1
    return count


@compiled
def nearest_to(
    cells: Cells, y0: float, y1: float, y2: float, reach2: float, runs: IntArray
) -> tuple[int, float]:
    """The point nearest to a position.

    Args:
        cells: of the cloud, at least the reach in size.
        y0: the position's x; y1, y2 likewise.
        y1: see ``y0``.
        y2: see ``y0``.
        reach2: square of the distance within which it is sought.
        runs: (9, 2) room.

    Returns:
        its row in cell order and its squared distance; −1 and ``reach2`` where none is near.
    """
    at, nearest = -1, reach2
    for run in range(runs_around(cells, y0, y1, y2, runs)):
        for p in range(runs[run, 0], runs[run, 1]):
            d0, d1, d2 = cells.points[p, 0] - y0, cells.points[p, 1] - y1, cells.points[p, 2] - y2
            distance2 = d0 * d0 + d1 * d1 + d2 * d2
            if distance2 < nearest:
                at, nearest = p, distance2
    return at, nearest
