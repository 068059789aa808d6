"""What a cloud looks like near each point: how dense it is, and which way it faces."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from model.compiled import compiled
from model.profile import gaussian
from model.surface.axes import least_axis
from model.surface.cells import Cells, FloatArray, cells_of, runs_around

# A Poisson sample of density λ has its sixth neighbour at √(6/πλ) on average.
_NEIGHBOUR = 6
# Normals are fitted to a Gaussian ball of this many spacings.
_BALL = 1.3
_REACH = 2.0  # of the ball, in its standard deviations
_FEWEST = 4
# Cells in which neighbours are sought first, in spacings of points spread over the bounding box;
# they are doubled until most points have theirs.
_FIRST_CELL, _WIDENINGS = 1.2, 8

# Cells, fitted normals (N, 3) in their order, the reach of a neighbour and the spacing → normals.
Correct = Callable[[Cells, FloatArray, float, float], FloatArray]


class Planes(NamedTuple):
    """Planes fitted around every point of a cloud, in cell order.

    Attributes:
        cells: of the cloud.
        normals: (N, 3).
        heights: (N,) of the points above the mean of their neighbours.
        reach: within which points are neighbours.
        spacing: see Patches.
    """

    cells: Cells
    normals: FloatArray
    heights: FloatArray
    reach: float
    spacing: float

    @classmethod
    def of(cls, points: FloatArray, spacing: float | None = None) -> Planes:
        """Fit them to points (N, 3), whose spacing may be known already."""
        spacing = surface_spacing(points) if spacing is None else spacing
        reach = neighbour_reach(spacing)
        cells = cells_of(points, reach)
        return cls(cells, *_normals(cells, reach, _BALL * spacing), reach, spacing)


@dataclass(frozen=True, slots=True)
class Patches:
    """A cloud with the frame of its surface at each point.

    Attributes:
        points: (N, 3).
        normals: (N, 3) unit normals without orientation; zero where too few points are near.
        spacing: edge of the square that one point stands for, the median over the cloud.
        roughness: median height of a point above the mean of its neighbours, in spacings: noise,
            or a surface that bends within a few spacings.
    """

    points: FloatArray
    normals: FloatArray
    spacing: float
    roughness: float

    @classmethod
    def of(
        cls, points: FloatArray, spacing: float | None = None, correct: Correct | None = None
    ) -> Patches:
        """Fit a plane around every point.

        Args:
            points: (N, 3).
            spacing: if it is known already.
            correct: improves the fitted normals; see ``CompiledNormals``.
        """
        cells, fitted, heights, reach, spacing = Planes.of(points, spacing)
        normals = np.empty_like(points)
        normals[cells.order] = fitted if correct is None else correct(cells, fitted, reach, spacing)
        return cls(points, normals, spacing, float(np.median(heights)) / spacing)


def neighbour_reach(spacing: float) -> float:
    """Within which points have a say in each other's normals."""
    return _REACH * _BALL * spacing


def surface_spacing(points: FloatArray) -> float:
    """√(area a point), from the distance to the sixth neighbour: clumps don't mislead it.

    Args:
        points: (N, 3), at least 2.
    """
    k = min(_NEIGHBOUR, len(points) - 1)
    return _median_distance(points, k) * math.sqrt(math.pi / k)


def _median_distance(points: FloatArray, k: int) -> float:
    """Median over the points (N, 3) of the distance to the k-th nearest other."""
    a, b, c = np.ptp(points, axis=0).tolist()
    area = 2.0 * (a * b + b * c + c * a)
    if area > 0.0:
        size = _FIRST_CELL * math.sqrt(area / len(points))
        for _ in range(_WIDENINGS):
            median = float(np.median(_nth_distances(cells_of(points, size), k)))
            if math.isfinite(median):
                return median
            size *= 2.0
    return float(np.median(np.asarray(KDTree(points).query(points, k=[k + 1])[0])))


@compiled
def _nth_distances(cells: Cells, n: int) -> FloatArray:
    """(N,) distance to the n-th nearest other point; infinite beyond a cell's size."""
    x = cells.points
    out = np.full(len(x), np.inf)
    runs = np.empty((9, 2), np.int64)
    d2 = np.empty(len(x) + 1)
    for i in range(len(x)):
        near = 0
        for run in range(runs_around(cells, x[i, 0], x[i, 1], x[i, 2], runs)):
            for p in range(runs[run, 0], runs[run, 1]):
                d0, d1, e = x[p, 0] - x[i, 0], x[p, 1] - x[i, 1], x[p, 2] - x[i, 2]
                d2[near] = d0 * d0 + d1 * d1 + e * e
                near += d2[near] <= cells.size * cells.size
        if near <= n:
            continue
        # One distance after another, the point itself first: a sort would branch at every step.
        nth, passed = -1.0, 0
        while passed <= n:
            least = np.inf
            for p in range(near):
                least = min(least, d2[p] if d2[p] > nth else np.inf)
            for p in range(near):
                passed += d2[p] == least
            nth = least
        out[i] = math.sqrt(nth)
    return out


@compiled
def _normals(cells: Cells, reach: float, sigma: float) -> tuple[FloatArray, FloatArray]:
    """(N, 3) in cell order: the least principal axis of a Gaussian ball; (N,) heights above it."""
    x = cells.points
    out, heights = np.zeros_like(x), np.zeros(len(x))
    runs = np.empty((9, 2), np.int64)
    inverse2, reach2 = 1.0 / (sigma * sigma), reach * reach
    d = np.empty((3, len(x) + 1))
    for i in range(len(x)):
        near = 0
        for run in range(runs_around(cells, x[i, 0], x[i, 1], x[i, 2], runs)):
            for p in range(runs[run, 0], runs[run, 1]):
                d0, d1, d2 = x[p, 0] - x[i, 0], x[p, 1] - x[i, 1], x[p, 2] - x[i, 2]
                d[0, near], d[1, near], d[2, near] = d0, d1, d2
                # Without a branch: half of the points around are too far.
                near += d0 * d0 + d1 * d1 + d2 * d2 <= reach2
        if near < _FEWEST:
            continue
        w_sum = s0 = s1 = s2 = c00 = c01 = c02 = c11 = c12 = c22 = 0.0
        for p in range(near):
            d0, d1, d2 = d[0, p], d[1, p], d[2, p]
            w = gaussian((d0 * d0 + d1 * d1 + d2 * d2) * inverse2)
            w_sum += w
            s0, s1, s2 = s0 + w * d0, s1 + w * d1, s2 + w * d2
            c00, c01, c02 = c00 + w * d0 * d0, c01 + w * d0 * d1, c02 + w * d0 * d2
            c11, c12, c22 = c11 + w * d1 * d1, c12 + w * d1 * d2, c22 + w * d2 * d2
        s0, s1, s2 = s0 / w_sum, s1 / w_sum, s2 / w_sum
        n0, n1, n2 = least_axis(
            c00 / w_sum - s0 * s0,
            c01 / w_sum - s0 * s1,
            c02 / w_sum - s0 * s2,
            c11 / w_sum - s1 * s1,
            c12 / w_sum - s1 * s2,
            c22 / w_sum - s2 * s2,
        )
        out[i, 0], out[i, 1], out[i, 2] = n0, n1, n2
        heights[i] = abs(n0 * s0 + n1 * s1 + n2 * s2)
    return out, heights
