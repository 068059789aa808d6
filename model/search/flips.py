"""Other poses that a nearly symmetric object allows: a good pose, turned about the object's axes.

Where an object looks nearly alike after a quarter or half turn, features match it to the turned one
with confidence; only the whole clouds then tell which is right, and both poses must be in the race.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.surface import SurfaceCloud

FloatArray = npt.NDArray[np.float64]

# Stray points don't move the middle of a cloud.
_ENDS = (0.01, 0.99)
_HALF, _QUARTER = np.pi, 0.5 * np.pi
# A cloud that normals were not fitted to has no axes of normals.
_FEWEST_NORMALS = 0.5


def flipped_poses(T: FloatArray, target: SurfaceCloud, source: SurfaceCloud) -> FloatArray:
    """T (4, 4), turned about axes of both clouds together, as they lie at T, (12, 4, 4).

    Half and quarter turns about the principal axes of the normals through the middle of the
    extents, as of things built at right angles, and half turns about the principal axes of the
    points through their centroid.

    Args:
        T: T_target_source.
        target: N points.
        source: M points.
    """
    R, t = T[:3, :3], T[:3, 3]
    points = np.concatenate([target.arrays.points, source.arrays.points @ R.T + t])
    normals = np.concatenate([target.arrays.normals, source.arrays.normals @ R.T])
    centroid = points.mean(axis=0)
    spread = principal_axes(points - centroid)
    facing = spread
    if np.square(normals).sum() > _FEWEST_NORMALS * len(normals):
        facing = principal_axes(normals)
    low, high = np.quantile(points @ facing, _ENDS, axis=0)
    middle = facing @ (0.5 * (low + high))
    turns = [turn(facing[:, a], angle, middle) for a in range(3) for angle in _right_angles()]
    turns += [turn(spread[:, a], _HALF, centroid) for a in range(3)]
    return np.stack(turns) @ T


def principal_axes(vectors: FloatArray) -> FloatArray:
    """(3, 3) columns: eigenvectors of Σ v vᵀ of (N, 3)."""
    axes: FloatArray = np.linalg.eigh(vectors.T @ vectors)[1]
    return axes


def turn(axis: FloatArray, angle: float, centre: FloatArray) -> FloatArray:
    """(4, 4) rotation by ``angle`` radians about an axis (3,) through ``centre`` (3,)."""
    S = np.eye(4)
    S[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix()
    S[:3, 3] = centre - S[:3, :3] @ centre
    return S


def _right_angles() -> tuple[float, float, float]:
    return _HALF, _QUARTER, -_QUARTER
