"""Principal axes of a symmetric 3 × 3 matrix, for the compiled loops."""

from __future__ import annotations

import math

import numpy as np

from model.compiled import compiled

# Jacobi's rotations converge quadratically: from the third sweep on little is left.
_SWEEPS = 8
_NOTHING = 1e-30

Vector = tuple[float, float, float]


@compiled
def least_axis(c00: float, c01: float, c02: float, c11: float, c12: float, c22: float) -> Vector:
    """The unit eigenvector of the least eigenvalue, by Jacobi's rotations.

    LAPACK's call takes ten times as long for so small a matrix.
    """
    C = np.empty((3, 3))
    C[0, 0], C[1, 1], C[2, 2] = c00, c11, c22
    C[0, 1] = C[1, 0] = c01
    C[0, 2] = C[2, 0] = c02
    C[1, 2] = C[2, 1] = c12
    V = np.eye(3)
    for _ in range(_SWEEPS):
        off = C[0, 1] * C[0, 1] + C[0, 2] * C[0, 2] + C[1, 2] * C[1, 2]
        if off <= _NOTHING * (C[0, 0] * C[0, 0] + C[1, 1] * C[1, 1] + C[2, 2] * C[2, 2]):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if C[p, q] != 0.0:
                    _rotate(C, V, p, q)
    least = 0
    for k in range(1, 3):
        if C[k, k] < C[least, least]:
            least = k
    return V[0, least], V[1, least], V[2, least]


@compiled
def _rotate(C: np.ndarray, V: np.ndarray, p: int, q: int) -> None:
    """Turn the plane of two axes so that C[p, q] vanishes."""
    theta = 0.5 * (C[q, q] - C[p, p]) / C[p, q]
    t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
    if theta < 0.0:
        t = -t
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for k in range(3):
        a, b = C[k, p], C[k, q]
        C[k, p], C[k, q] = c * a - s * b, s * a + c * b
    for k in range(3):
        a, b = C[p, k], C[q, k]
        C[p, k], C[q, k] = c * a - s * b, s * a + c * b
        a, b = V[k, p], V[k, q]
        V[k, p], V[k, q] = c * a - s * b, s * a + c * b
