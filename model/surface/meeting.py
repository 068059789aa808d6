"""How closely two clouds meet at a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model.compiled import compiled
from model.surface.arrays import SurfaceArrays
from model.surface.cells import Cells, FloatArray, nearest_to
from model.surface.cloud import SurfaceCloud
from model.surface.rigid import moved

# Points farther apart than this many spacings don't meet.
_NEAR = 1.2
# Independent samples of a surface have their nearest points √(ln 2/π) = 0.47 spacings apart in the
# median; clouds that meet more closely than this share their points.
_SHARED = 0.3
# As many points must meet for a median to mean anything, or a third of a tiny cloud.
_FEWEST = 20


@dataclass(frozen=True, slots=True)
class Meeting:
    """Of the source's points that have a target point near.

    Attributes:
        distance: median distance to the nearest.
        height: median height above the nearest's plane.
        apart: whether the clouds are independent samples, and don't share their points.
    """

    distance: float
    height: float
    apart: bool

    @classmethod
    def of(cls, target: SurfaceCloud, source: SurfaceCloud, T: FloatArray) -> Meeting | None:
        """Measure at T (4, 4); None where too few points meet to say."""
        spacing = max(target.spacing, source.spacing)
        reach = _NEAR * spacing
        view = target.at(reach)
        distance, height = nearest(view.cells, view.arrays, source.arrays, T, reach)
        near = distance < reach
        if int(near.sum()) < max(3, min(_FEWEST, len(near) // 3)):
            return None
        median = float(np.median(distance[near]))
        return cls(median, float(np.median(height[near])), median > _SHARED * spacing)


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
        y0, y1, y2 = moved(T, source.points, j)
        at, distance2 = nearest_to(cells, y0, y1, y2, reach * reach, runs)
        if at >= 0:
            distance[j] = np.sqrt(distance2)
            height[j] = abs(
                target.normals[at, 0] * (target.points[at, 0] - y0)
                + target.normals[at, 1] * (target.points[at, 1] - y1)
                + target.normals[at, 2] * (target.points[at, 2] - y2)
            )
    return distance, height
