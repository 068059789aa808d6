"""One point or vector of a cloud at a pose, for the compiled loops."""

from __future__ import annotations

from model.compiled import compiled
from model.surface.cells import FloatArray

Vector = tuple[float, float, float]


@compiled
def moved(T: FloatArray, points: FloatArray, j: int) -> Vector:
    """R z_j + t of points (M, 3)."""
    z0, z1, z2 = points[j, 0], points[j, 1], points[j, 2]
    return (
        T[0, 0] * z0 + T[0, 1] * z1 + T[0, 2] * z2 + T[0, 3],
        T[1, 0] * z0 + T[1, 1] * z1 + T[1, 2] * z2 + T[1, 3],
        T[2, 0] * z0 + T[2, 1] * z1 + T[2, 2] * z2 + T[2, 3],
    )


@compiled
def turned(T: FloatArray, normals: FloatArray, j: int) -> Vector:
    """R n_j of normals (M, 3)."""
    n0, n1, n2 = normals[j, 0], normals[j, 1], normals[j, 2]
    return (
        T[0, 0] * n0 + T[0, 1] * n1 + T[0, 2] * n2,
        T[1, 0] * n0 + T[1, 1] * n1 + T[1, 2] * n2,
        T[2, 0] * n0 + T[2, 1] * n1 + T[2, 2] * n2,
    )
