"""Balls around the points of one cloud and their moments, compiled."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.encoder.dense import Array32
from model.profile import gaussian

FloatArray = npt.NDArray[np.float64]


@compiled
def weigh_ball(
    x: FloatArray, radius: float, compact: bool, weights: Array32
) -> tuple[FloatArray, FloatArray]:
    """Weigh the neighbours of every point, and take the moments of what they look like from it.

    Args:
        x: (3, N).
        radius: standard deviation of a Gaussian ball, or where a compact one ends.
        compact: whether the weight is (1 − r²/radius²)² and not exp(−r²/2 radius²).
        weights: (≥ N, N) is filled; each row sums to 1.

    Returns:
        the weighted mean (N, 3) of neighbours less the point, and their covariance (N, 3, 3).
    """
    n = x.shape[1]
    mean, covariance = np.empty((n, 3)), np.empty((n, 3, 3))
    row = np.empty(n)
    a = 1.0 / (radius * radius)
    for i in range(n):
        x0, x1, x2 = x[0, i], x[1, i], x[2, i]
        if compact:
            for j in range(n):
                d0, d1, d2 = x[0, j] - x0, x[1, j] - x1, x[2, j] - x2
                inside = max(0.0, 1.0 - (d0 * d0 + d1 * d1 + d2 * d2) * a)
                row[j] = inside * inside
        else:
            for j in range(n):
                d0, d1, d2 = x[0, j] - x0, x[1, j] - x1, x[2, j] - x2
                row[j] = gaussian((d0 * d0 + d1 * d1 + d2 * d2) * a)
        total = s0 = s1 = s2 = c00 = c01 = c02 = c11 = c12 = c22 = 0.0
        for j in range(n):
            w = row[j]
            d0, d1, d2 = x[0, j] - x0, x[1, j] - x1, x[2, j] - x2
            w0, w1, w2 = w * d0, w * d1, w * d2
            total += w
            s0, s1, s2 = s0 + w0, s1 + w1, s2 + w2
            c00, c01, c02 = c00 + w0 * d0, c01 + w0 * d1, c02 + w0 * d2
            c11, c12, c22 = c11 + w1 * d1, c12 + w1 * d2, c22 + w2 * d2
        inverse = 1.0 / total
        for j in range(n):
            weights[i, j] = np.float32(row[j] * inverse)
        s0, s1, s2 = s0 * inverse, s1 * inverse, s2 * inverse
        mean[i, 0], mean[i, 1], mean[i, 2] = s0, s1, s2
        covariance[i, 0, 0] = c00 * inverse - s0 * s0
        covariance[i, 1, 1] = c11 * inverse - s1 * s1
        covariance[i, 2, 2] = c22 * inverse - s2 * s2
        covariance[i, 0, 1] = covariance[i, 1, 0] = c01 * inverse - s0 * s1
        covariance[i, 0, 2] = covariance[i, 2, 0] = c02 * inverse - s0 * s2
        covariance[i, 1, 2] = covariance[i, 2, 1] = c12 * inverse - s1 * s2
    return mean, covariance


@compiled
def first_look(
    means: FloatArray, covariances: FloatArray, widths: FloatArray
) -> tuple[Array32, Array32]:
    """First vectors (N, 3, V) and invariants (N, S) of ``ball_moments``, from the balls' moments.

    Args:
        means: (R, N, 3).
        covariances: (R, N, 3, 3).
        widths: (R,) of the balls.
    """
    R, n = means.shape[0], means.shape[1]
    pairs = R * (R - 1) // 2
    chirality = R if R > 1 else 0
    vectors = np.empty((n, 3, R + R * R + pairs), np.float32)
    scalars = np.empty((n, R * (R + 1) // 2 + 2 * R + pairs + R * R + chirality), np.float32)
    v, C = np.empty((R, 3)), np.empty((R, 3, 3))
    seen = np.empty((R, R, 3))
    for i in range(n):
        for r in range(R):
            for a in range(3):
                v[r, a] = means[r, i, a] / widths[r]
                for b in range(3):
                    C[r, a, b] = covariances[r, i, a, b] / (widths[r] * widths[r])
        for s in range(R):
            for r in range(R):
                for a in range(3):
                    seen[s, r, a] = (
                        C[s, a, 0] * v[r, 0] + C[s, a, 1] * v[r, 1] + C[s, a, 2] * v[r, 2]
                    )
        column = 0
        for r in range(R):
            for a in range(3):
                vectors[i, a, r] = v[r, a]
                for s in range(R):
                    vectors[i, a, R + s * R + r] = seen[s, r, a]
        for r in range(R):
            for s in range(r + 1, R):
                at = R + R * R + column
                vectors[i, 0, at] = v[r, 1] * v[s, 2] - v[r, 2] * v[s, 1]
                vectors[i, 1, at] = v[r, 2] * v[s, 0] - v[r, 0] * v[s, 2]
                vectors[i, 2, at] = v[r, 0] * v[s, 1] - v[r, 1] * v[s, 0]
                column += 1
        _invariants(v, C, seen, scalars[i])
    return vectors, scalars


@compiled
def _invariants(v: FloatArray, C: FloatArray, seen: FloatArray, out: Array32) -> None:
    """Fill (S,) with what the balls of one point look like from every side."""
    R, at = len(v), 0
    for r in range(R):
        for s in range(r, R):
            out[at] = _times(v[r], v[s])
            at += 1
    for r in range(R):
        out[at] = C[r, 0, 0] + C[r, 1, 1] + C[r, 2, 2]
        out[at + 1] = _dot(C[r], C[r])
        at += 2
    for r in range(R):
        for s in range(r + 1, R):
            out[at] = _dot(C[r], C[s])
            at += 1
    for s in range(R):
        for r in range(R):
            out[at] = _times(v[r], seen[s, r])
            at += 1
    if R > 1:
        n0 = v[0, 1] * v[1, 2] - v[0, 2] * v[1, 1]
        n1 = v[0, 2] * v[1, 0] - v[0, 0] * v[1, 2]
        n2 = v[0, 0] * v[1, 1] - v[0, 1] * v[1, 0]
        for s in range(R):
            out[at] = n0 * seen[s, 0, 0] + n1 * seen[s, 0, 1] + n2 * seen[s, 0, 2]
            at += 1


@compiled
def _times(a: FloatArray, b: FloatArray) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@compiled
def _dot(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += a[i, j] * b[i, j]
    return total
