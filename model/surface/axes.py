"""Principal axes of a symmetric 3 × 3 matrix, for the compiled loops."""

from __future__ import annotations

import math

import numpy as np

from model.compiled import compiled

# Jacobi's rotations converge quadratically: from the third sweep on little is left.
_SWEEPS = 8
_NOTHING = 1e-30
# sin² between the two rows of C − λI that are the least parallel.
_PARALLEL = 1e-8

Vector = tuple[float, float, float]


@compiled
def least_axis(c00: float, c01: float, c02: float, c11: float, c12: float, c22: float) -> Vector:
    """The unit eigenvector of the least eigenvalue.

    It is across the rows of C − λI, with λ from the characteristic polynomial; where the two least
    eigenvalues are so nearly equal that these rows are parallel, Jacobi's rotations tell it.
    """
    q = (c00 + c11 + c22) / 3.0
    a, b, c = c00 - q, c11 - q, c22 - q
    off = c01 * c01 + c02 * c02 + c12 * c12
    p = math.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    if p * p <= _NOTHING * q * q:
        return 1.0, 0.0, 0.0
    half = a * (b * c - c12 * c12) - c01 * (c01 * c - c12 * c02) + c02 * (c01 * c12 - b * c02)
    angle = math.acos(min(1.0, max(-1.0, 0.5 * half / (p * p * p)))) / 3.0
    least = 2.0 * p * math.cos(angle + 2.0 * math.pi / 3.0)
    a, b, c = a - least, b - least, c - least
    u = (c01 * c12 - c02 * b, c02 * c01 - a * c12, a * b - c01 * c01)
    v = (c01 * c - c02 * c12, c02 * c02 - a * c, a * c12 - c01 * c02)
    w = (b * c - c12 * c12, c12 * c02 - c01 * c, c01 * c12 - b * c02)
    u2, v2, w2 = _dot(u, u), _dot(v, v), _dot(w, w)
    axis, length2 = u, u2
    if v2 > length2:
        axis, length2 = v, v2
    if w2 > length2:
        axis, length2 = w, w2
    # Each is a product of two rows, none of which is longer than about 3 p.
    if length2 <= _PARALLEL * p * p * p * p:
        return _jacobi(c00, c01, c02, c11, c12, c22)
    share = 1.0 / math.sqrt(length2)
    return axis[0] * share, axis[1] * share, axis[2] * share


@compiled
def _dot(u: Vector, v: Vector) -> float:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


@compiled
def _jacobi(c00: float, c01: float, c02: float, c11: float, c12: float, c22: float) -> Vector:
    """``least_axis`` by rotations that make the matrix diagonal."""
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
