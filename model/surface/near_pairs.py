"""Which points of two clouds are near each other: found once, good while the pose moves little."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.surface.cells import Cells, FloatArray, IntArray, runs_around
from model.surface.rigid import moved

Rows = npt.NDArray[np.int32]

# Pairs are listed out to this many times the kernel's end; the pose may move by the difference.
SLACK = 1.25
_FIRST_ROOM = 32


class NearPairs(NamedTuple):
    """Pairs of points, source by source.

    Attributes:
        start: (M + 1,) where each source point's pairs begin.
        target: (P,) rows of the target's points.
    """

    start: IntArray
    target: Rows


@compiled
def near_pairs(
    cells: Cells, target: FloatArray, source: FloatArray, T: FloatArray, reach: float
) -> NearPairs:
    """All pairs nearer than ``reach`` at T (4, 4).

    Args:
        cells: of the target, at least ``reach`` in size.
        target: (N, 3) in cell order.
        source: (M, 3).
        T: T_target_source.
        reach: of a pair.
    """
    start = np.zeros(len(source) + 1, np.int64)
    near = np.empty(_FIRST_ROOM * len(source), np.int32)
    runs = np.empty((9, 2), np.int64)
    count, reach2 = 0, reach * reach
    for j in range(len(source)):
        y0, y1, y2 = moved(T, source, j)
        for run in range(runs_around(cells, y0, y1, y2, runs)):
            a, b = runs[run, 0], runs[run, 1]
            near = with_room(near, count, b - a)
            for p in range(a, b):
                d0, d1, d2 = target[p, 0] - y0, target[p, 1] - y1, target[p, 2] - y2
                near[count] = p
                # Without a branch: most of the points around are too far.
                count += d0 * d0 + d1 * d1 + d2 * d2 <= reach2
        start[j + 1] = count
    return NearPairs(start, near[:count].copy())


@compiled
def own_pairs(cells: Cells, reach: float) -> NearPairs:
    """All pairs of different points of one cloud, in cell order, nearer than ``reach``; each once.

    Args:
        cells: of the cloud, at least ``reach`` in size.
        reach: of a pair.
    """
    x = cells.points
    start = np.zeros(len(x) + 1, np.int64)
    near = np.empty(_FIRST_ROOM * len(x), np.int32)
    runs = np.empty((9, 2), np.int64)
    count, reach2 = 0, reach * reach
    for j in range(len(x)):
        for run in range(runs_around(cells, x[j, 0], x[j, 1], x[j, 2], runs)):
            a, b = max(runs[run, 0], j + 1), runs[run, 1]
            near = with_room(near, count, b - a)
            for p in range(a, b):
                d0, d1, d2 = x[p, 0] - x[j, 0], x[p, 1] - x[j, 1], x[p, 2] - x[j, 2]
                near[count] = p
                count += d0 * d0 + d1 * d1 + d2 * d2 <= reach2
        start[j + 1] = count
    return NearPairs(start, near[:count].copy())


@compiled
def with_room(near: Rows, count: int, more: int) -> Rows:
    """``near`` with room for ``more`` rows after the first ``count``."""
    if count + more <= len(near):
        return near
    larger = np.empty(2 * len(near) + more, np.int32)
    larger[:count] = near[:count]
    return larger


@compiled
def longest_run(pairs: NearPairs) -> int:
    """The most pairs that one source point has."""
    longest = 0
    for j in range(len(pairs.start) - 1):
        longest = max(longest, pairs.start[j + 1] - pairs.start[j])
    return longest


@compiled
def farthest_move(source: FloatArray, T: FloatArray, T_other: FloatArray) -> float:
    """How far the points (M, 3) at T lie from themselves at the other pose, at most."""
    D = T_other - T
    most = 0.0
    for j in range(len(source)):
        z0, z1, z2 = source[j, 0], source[j, 1], source[j, 2]
        d0 = D[0, 0] * z0 + D[0, 1] * z1 + D[0, 2] * z2 + D[0, 3]
        d1 = D[1, 0] * z0 + D[1, 1] * z1 + D[1, 2] * z2 + D[1, 3]
        d2 = D[2, 0] * z0 + D[2, 1] * z1 + D[2, 2] * z2 + D[2, 3]
        most = max(most, d0 * d0 + d1 * d1 + d2 * d2)
    return math.sqrt(most)
