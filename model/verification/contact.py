"""How each point of a cloud meets the other cloud at a pose: what a close look at a pose sees."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.surface.arrays import SurfaceArrays
from model.surface.cells import Cells, FloatArray, IntArray, nearest_to
from model.surface.cloud import MOST_NEIGHBOURS, SurfaceCloud
from model.surface.rigid import moved, turned

# Neighbours in the other cloud are sought this far, in spacings.
REACH = 3.0
# Beyond this a neighbour's normal and features say nothing.
_RELATED = 2.0
# Neighbours in the own cloud: of its edge and of a small mean; a wide one has all that are known.
_SMALL = 12
# A close look takes about this many points of each cloud.
POINTS = 192

TRAITS = (
    "very_close",
    "close",
    "near",
    "within_reach",
    "facing",
    "level",
    "on_surface",
    "likeness_of_first_channels",
    "likeness_of_last_channels",
    "own_edge",
    "other_edge",
    "near_around",
    "on_surface_around",
    "near_far_around",
    "beyond_edge",
    "distance",
)


class Surroundings(NamedTuple):
    """Of the points of one cloud, within it.

    Attributes:
        neighbours: (N, k) nearest other points, the nearest first.
        edge: (N, 3) towards where there are no points; its norm is 0 amid a surface and about 1/2
            at the end of one, be it an object's or a crop's.
    """

    neighbours: IntArray
    edge: FloatArray


def surroundings(cloud: SurfaceCloud, reach: float) -> Surroundings:
    """Of the points in the order of ``cloud.at(reach)``; found once."""

    def found() -> Surroundings:
        index = cloud.neighbours(reach, MOST_NEIGHBOURS)
        return Surroundings(index, edges(cloud)[cloud.at(reach).cells.order])

    return cloud.remembered(("surroundings", reach), found)


def edges(cloud: SurfaceCloud) -> FloatArray:
    """See Surroundings; in the given order, found once."""

    def found() -> FloatArray:
        points, index = cloud.arrays.points, cloud.nearest()
        offsets = points[index[:, :_SMALL]] - points[:, None]
        size = np.linalg.norm(offsets, axis=2).mean(axis=1, keepdims=True)
        edge: FloatArray = -offsets.mean(axis=1) / np.maximum(size, 1e-12)
        return edge

    return cloud.remembered("edges", found)


def contact(target: SurfaceCloud, source: SurfaceCloud, T: FloatArray) -> npt.NDArray[np.float32]:
    """The traits of points of both clouds at one pose, (2, POINTS, len(TRAITS)).

    Source points come first, then target points; of a smaller cloud some are taken twice.

    Args:
        target: N points.
        source: M points.
        T: (4, 4) T_target_source.
    """
    spacing = max(target.spacing, source.spacing)
    reach = REACH * spacing
    fixed, moving = target.at(reach), source.at(reach)
    beside_fixed, beside_moving = surroundings(target, reach), surroundings(source, reach)
    inverse = np.linalg.inv(T).astype(np.float64)
    of_source = _traits(
        fixed.cells, fixed.arrays, beside_fixed, moving.arrays, beside_moving, T, spacing
    )
    of_target = _traits(
        moving.cells,
        moving.arrays,
        beside_moving,
        fixed.arrays,
        beside_fixed,
        inverse,
        spacing,
    )
    return np.stack([traits[_some(len(traits))] for traits in (of_source, of_target)])


def _some(count: int) -> IntArray:
    """Rows spread evenly over the cells."""
    rows: IntArray = (np.arange(POINTS) * (count / POINTS)).astype(np.int64)
    return rows


@compiled
def _traits(
    cells: Cells,
    fixed: SurfaceArrays,
    beside_fixed: Surroundings,
    moving: SurfaceArrays,
    beside_moving: Surroundings,
    T: FloatArray,
    spacing: float,
) -> npt.NDArray[np.float32]:
    """(M, len(TRAITS)) of the moving points, from each one's nearest fixed point."""
    count = len(moving.points)
    channels = fixed.features.shape[1] // 3
    half = channels // 2
    out = np.zeros((count, 16), np.float32)
    runs = np.empty((9, 2), np.int64)
    reach2 = (REACH * spacing) ** 2
    for j in range(count):
        e0, e1, e2 = beside_moving.edge[j, 0], beside_moving.edge[j, 1], beside_moving.edge[j, 2]
        out[j, 9] = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        y0, y1, y2 = moved(T, moving.points, j)
        at, nearest = nearest_to(cells, y0, y1, y2, reach2, runs)
        d = math.sqrt(nearest) / spacing
        out[j, 0] = math.exp(-8.0 * d * d)
        out[j, 1] = math.exp(-2.0 * d * d)
        out[j, 2] = near = math.exp(-0.5 * d * d)
        out[j, 3] = math.exp(-0.125 * d * d)
        out[j, 15] = d / REACH
        if at < 0:
            continue
        x0, x1, x2 = fixed.normals[at, 0], fixed.normals[at, 1], fixed.normals[at, 2]
        m0, m1, m2 = turned(T, moving.normals, j)
        d0, d1, d2 = fixed.points[at, 0] - y0, fixed.points[at, 1] - y1, fixed.points[at, 2] - y2
        above = abs(x0 * d0 + x1 * d1 + x2 * d2) + abs(m0 * d0 + m1 * d1 + m2 * d2)
        h = 0.5 * above / spacing
        out[j, 5] = math.exp(-50.0 * h * h) * near
        out[j, 6] = math.exp(-5.5 * h * h) * near
        e0, e1, e2 = beside_fixed.edge[at, 0], beside_fixed.edge[at, 1], beside_fixed.edge[at, 2]
        out[j, 10] = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        beyond = -(d0 * e0 + d1 * e1 + d2 * e2) / spacing
        out[j, 14] = min(2.0, max(-2.0, beyond))
        if d < _RELATED:
            out[j, 4] = abs(x0 * m0 + x1 * m1 + x2 * m2)
            out[j, 7] = likeness_of(fixed.features, at, moving.features, j, T, 0, half)
            out[j, 8] = likeness_of(fixed.features, at, moving.features, j, T, half, channels)
    neighbours = beside_moving.neighbours
    small = min(12, neighbours.shape[1])
    for j in range(count):
        near_small = on_small = near_wide = 0.0
        for a in range(neighbours.shape[1]):
            near_wide += out[neighbours[j, a], 2]
            if a < small:
                near_small += out[neighbours[j, a], 2]
                on_small += out[neighbours[j, a], 6]
        out[j, 11], out[j, 12] = near_small / small, on_small / small
        out[j, 13] = near_wide / neighbours.shape[1]
    return out


@compiled
def likeness_of(
    fixed: npt.NDArray[np.float32],
    i: int,
    moving: npt.NDArray[np.float32],
    j: int,
    T: FloatArray,
    first: int,
    past: int,
) -> float:
    """Cosine of some channels of the features of two points at T; 0 without channels."""
    channels = fixed.shape[1] // 3
    product = own = other = 0.0
    for c in range(first, past):
        g0, g1, g2 = moving[j, c], moving[j, channels + c], moving[j, 2 * channels + c]
        f0, f1, f2 = fixed[i, c], fixed[i, channels + c], fixed[i, 2 * channels + c]
        product += f0 * (T[0, 0] * g0 + T[0, 1] * g1 + T[0, 2] * g2)
        product += f1 * (T[1, 0] * g0 + T[1, 1] * g1 + T[1, 2] * g2)
        product += f2 * (T[2, 0] * g0 + T[2, 1] * g1 + T[2, 2] * g2)
        own += g0 * g0 + g1 * g1 + g2 * g2
        other += f0 * f0 + f1 * f1 + f2 * f2
    return product / math.sqrt(own * other + 1e-12)
