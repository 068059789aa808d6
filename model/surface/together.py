"""Both clouds of a pair as one, at a pose: normals fitted to all points, and what each counts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from model.surface.cells import Cells, FloatArray, IntArray
from model.surface.cloud import SurfaceCloud
from model.surface.patches import Planes

# Cells, fitted normals (N, 3) in their order, the reach of a neighbour, the spacing and which cloud
# each point is of → normals and weights (N,).
CorrectPair = Callable[[Cells, FloatArray, float, float, IntArray], tuple[FloatArray, FloatArray]]


def seen_together(
    target: SurfaceCloud, source: SurfaceCloud, T: FloatArray, correct: CorrectPair | None
) -> tuple[SurfaceCloud, SurfaceCloud]:
    """Both clouds with the normals that they have as one: of twice as many points where they meet.

    Args:
        target: N points.
        source: M points.
        T: (4, 4) T_target_source, roughly right.
        correct: improves fitted normals and weighs points; None takes the normals as fitted, and
            the weights as they are.
    """
    R, x = T[:3, :3], target.arrays.points
    moved = source.arrays.points @ R.T + T[:3, 3]
    planes = Planes.of(np.concatenate([x, moved]))
    order = planes.cells.order
    normals, weights = np.empty((len(order), 3)), np.ones(len(order))
    if correct is None:
        normals[order] = planes.normals
    else:
        layer = (order >= len(x)).astype(np.int64)
        normals[order], weights[order] = correct(
            planes.cells, planes.normals, planes.reach, planes.spacing, layer
        )
    return (
        target.with_normals(normals[: len(x)], weights[: len(x)]),
        source.with_normals(normals[len(x) :] @ R, weights[len(x) :]),
    )
