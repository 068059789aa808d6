"""Other poses that smooth surfaces allow: a good pose, moved along what resists it least.

Where two clouds show other parts of a board, a rail or a shell, whole ranges of poses lay surface
on surface; how the ends of the clouds meet then tells which is right, and the judge sees that.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.search.flips import turn
from model.surface import SurfaceCloud, overlapping

FloatArray = npt.NDArray[np.float64]

# Motions that surfaces resist least; the others are held well enough.
_AXES = 2
# How far points move, root mean square, in spacings, either way; turns move them a little less.
_STEPS = (0.7, 1.4, 2.1, 3.0)
# Points with none of the other cloud within so many spacings don't resist.
_OVERLAP = 1.2


def slid_poses(
    T: FloatArray, target: SurfaceCloud, source: SurfaceCloud, spacing: float
) -> FloatArray:
    """T (4, 4), moved both ways along the motions that change heights above the surfaces least.

    Args:
        T: T_target_source.
        target: N points.
        source: M points.
        spacing: of the clouds.

    Returns:
        (16, 4, 4).
    """
    x, z = overlapping(target, source, T, _OVERLAP * spacing)
    R = T[:3, :3]
    points = np.concatenate([x.arrays.points, z.arrays.points @ R.T + T[:3, 3]])
    normals = np.concatenate([x.arrays.normals, z.arrays.normals @ R.T])
    centroid = points.mean(axis=0)
    centred = points - centroid
    radius = float(np.sqrt(np.mean(np.sum(centred**2, axis=1))))
    heights = np.concatenate([normals, np.cross(centred / radius, normals)], axis=1)
    weakest = np.linalg.eigh(heights.T @ heights)[1][:, :_AXES].T
    steps = spacing * np.concatenate([_STEPS, np.negative(_STEPS)])
    moves = [_moved(axis, step, centroid, radius) for axis in weakest for step in steps]
    return np.stack(moves) @ T


def _moved(motion: FloatArray, by: float, centre: FloatArray, radius: float) -> FloatArray:
    """(4, 4) the motion (ρ, radius · φ) of unit length, by so much."""
    angle = float(np.linalg.norm(motion[3:]))
    axis = motion[3:] / max(angle, 1e-12)
    S = turn(axis, by * angle / radius, centre)
    S[:3, 3] += by * motion[:3]
    return S
