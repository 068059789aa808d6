"""How closely two clouds meet at a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.compiled import compiled
from model.surface.cells import Cells, FloatArray, runs_around
from model.surface.cloud import SurfaceCloud
from model.surface.moments import SurfaceArrays

# Points farther apart than this many spacings don't meet.
_NEAR = 1.2
# As many points must meet for a median to mean anything, or a third of a tiny cloud.
_FEWEST = 20


@dataclass(frozen=True, slots=True)
class Meeting:
    """Of the source's points that have a target point near.

    Attributes:
        distance: median distance to the nearest.
        height: median height above the nearest's plane.
    """

    distance: float
    height: float

    @classmethod
    def of(cls, target: SurfaceCloud, source: SurfaceCloud, T: FloatArray) -> Meeting | None:
        """Measure at T (4, 4); None where too few points meet to say."""
        reach = _NEAR * max(target.spacing, source.spacing)
        view = target.at(reach)
        distance, height = nearest(view.cells, view.arrays, source.arrays, T, reach)
        near = distance < reach
        if int(near.sum()) < max(3, min(_FEWEST, len(near) // 3)):
            return None
        return cls(float(np.median(distance[near])), float(np.median(height[near])))


@compiled
def nearest(
    cells: Cells, target: SurfaceArrays, source: SurfaceArrays, T: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray]:
    """Distance to the nearest target point and height above its plane, each (M,).

    Args:
        cells: of the target, at least ``reach`` in size.
        target: in cell order.
        source: in any order.
        T: (4, 4) T_target_source.
        reach: the distance that stands where nothing is near.
    """
    distance = np.full(len(source.points), reach)
    height = np.zeros(len(source.points))
    runs = np.empty((9, 2), np.int64)
    for j in range(len(source.points)):
        z0, z1, z2 = source.points[j, 0], source.points[j, 1], source.points[j, 2]
        y0 = T[0, 0] * z0 + T[0, 1] * z1 + T[0, 2] * z2 + T[0, 3]
        y1 = T[1, 0] * z0 + T[1, 1] * z1 + T[1, 2] * z2 + T[1, 3]
        y2 = T[2, 0] * z0 + T[2, 1] * z1 + T[2, 2] * z2 + T[2, 3]
        best, at = reach * reach, -1
        for run in range(runs_around(cells, y0, y1, y2, runs)):
            for p in range(runs[run, 0], runs[run, 1]):
                d0 = target.points[p, 0] - y0
                d1 = target.points[p, 1] - y1
                d2 = target.points[p, 2] - y2
                distance2 = d0 * d0 + d1 * d1 + d2 * d2
                if distance2 < best:
                    best, at = distance2, p
        if at >= 0:
            distance[j] = np.sqrt(best)
            height[j] = abs(
                target.normals[at, 0] * (target.points[at, 0] - y0)
                + target.normals[at, 1] * (target.points[at, 1] - y1)
                + target.normals[at, 2] * (target.points[at, 2] - y2)
            )
    return distance, height
