"""Where two clouds overlap at a pose; what only one of them shows says nothing about the pose.

The kernel's sum grows with the overlap, so what the one cloud shows beyond the other's ends pulls
them over each other. Where nothing but such ends resists, as along a board of which each cloud has
another part, the pose slides by as much as was cut off. Functions that are both cut to what they
share have no such pull: at the true pose they end at the same places.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.surface.cells import Cells, FloatArray, IntArray, runs_around
from model.surface.cloud import SurfaceCloud
from model.surface.rigid import moved

Met = npt.NDArray[np.bool_]

# Where fewer points of either cloud meet the other, the pose is too wrong to tell what they share.
_FEWEST = 20


def overlapping(
    target: SurfaceCloud, source: SurfaceCloud, T: FloatArray, reach: float
) -> tuple[SurfaceCloud, SurfaceCloud]:
    """Both clouds without the points that have none of the other near.

    Args:
        target: N points.
        source: M points.
        T: (4, 4) T_target_source.
        reach: what is near.

    Returns:
        the same clouds where all points meet, or too few to tell.
    """
    view = target.at(reach)
    target_met, source_met = points_that_meet(view.cells, source.arrays.points, T, reach)
    if _few(target_met, source_met):
        return target, source
    return _cut(target, view.cells.order[target_met]), _cut(source, np.flatnonzero(source_met))


@compiled
def points_that_meet(
    cells: Cells, source: FloatArray, T: FloatArray, reach: float
) -> tuple[Met, Met]:
    """Which points have one of the other cloud near: (N,) in cell order, and (M,).

    Args:
        cells: of the target, at least ``reach`` in size.
        source: (M, 3).
        T: (4, 4) T_target_source.
        reach: what is near.
    """
    x, reach2 = cells.points, reach * reach
    target_met, source_met = np.zeros(len(x), np.bool_), np.zeros(len(source), np.bool_)
    runs = np.empty((9, 2), np.int64)
    for j in range(len(source)):
        y0, y1, y2 = moved(T, source, j)
        met = False
        for run in range(runs_around(cells, y0, y1, y2, runs)):
            for p in range(runs[run, 0], runs[run, 1]):
                d0, d1, d2 = x[p, 0] - y0, x[p, 1] - y1, x[p, 2] - y2
                near = d0 * d0 + d1 * d1 + d2 * d2 < reach2
                target_met[p] |= near
                met |= near
        source_met[j] = met
    return target_met, source_met


def _few(target_met: Met, source_met: Met) -> bool:
    return min(int(target_met.sum()), int(source_met.sum())) < _FEWEST


def _cut(cloud: SurfaceCloud, rows: IntArray) -> SurfaceCloud:
    if len(rows) == len(cloud.arrays.points):
        return cloud
    return cloud.select(np.sort(rows), cloud.spacing)
