"""Layers of small matrices over the points of one cloud, compiled."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.profile import gaussian

Array32 = npt.NDArray[np.float32]


@compiled
def add_product(x: Array32, weight: Array32, out: Array32) -> None:
    """Add x (n, K) @ weight (K, M) to ``out`` (n, M), four rows of the weight at once."""
    n, K = x.shape
    whole = K - K % 4
    for i in range(n):
        for k in range(0, whole, 4):
            a, b, c, d = x[i, k], x[i, k + 1], x[i, k + 2], x[i, k + 3]
            for m in range(weight.shape[1]):
                out[i, m] += (
                    a * weight[k, m]
                    + b * weight[k + 1, m]
                    + c * weight[k + 2, m]
                    + d * weight[k + 3, m]
                )
        for k in range(whole, K):
            a = x[i, k]
            for m in range(weight.shape[1]):
                out[i, m] += a * weight[k, m]


@compiled
def product_by_rows(x: Array32, y: Array32) -> Array32:
    """X (n, K) @ yᵀ (K, m) for long rows; n and m are multiples of four.

    Four rows of each are multiplied at once: sixteen sums that stay in registers.
    """
    n, m = len(x), len(y)
    out = np.empty((n, m), np.float32)
    for i in range(0, n, 4):
        for j in range(0, m, 4):
            s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = np.float32(0.0)
            s20 = s21 = s22 = s23 = s30 = s31 = s32 = s33 = np.float32(0.0)
            for k in range(x.shape[1]):
                a, b, c, d = x[i, k], x[i + 1, k], x[i + 2, k], x[i + 3, k]
                p, q, r, s = y[j, k], y[j + 1, k], y[j + 2, k], y[j + 3, k]
                s00, s01, s02, s03 = s00 + a * p, s01 + a * q, s02 + a * r, s03 + a * s
                s10, s11, s12, s13 = s10 + b * p, s11 + b * q, s12 + b * r, s13 + b * s
                s20, s21, s22, s23 = s20 + c * p, s21 + c * q, s22 + c * r, s23 + c * s
                s30, s31, s32, s33 = s30 + d * p, s31 + d * q, s32 + d * r, s33 + d * s
            out[i, j], out[i, j + 1] = s00, s01
            out[i, j + 2], out[i, j + 3] = s02, s03
            out[i + 1, j], out[i + 1, j + 1] = s10, s11
            out[i + 1, j + 2], out[i + 1, j + 3] = s12, s13
            out[i + 2, j], out[i + 2, j + 1] = s20, s21
            out[i + 2, j + 2], out[i + 2, j + 3] = s22, s23
            out[i + 3, j], out[i + 3, j + 1] = s30, s31
            out[i + 3, j + 2], out[i + 3, j + 3] = s32, s33
    return out


def padded(count: int) -> int:
    """The next multiple of four, which ``product_by_rows`` wants."""
    return -(-count // 4) * 4


@compiled
def product(x: Array32, weight: Array32) -> Array32:
    """X (n, K) @ weight (K, M)."""
    out = np.zeros((len(x), weight.shape[1]), np.float32)
    add_product(x, weight, out)
    return out


@compiled
def affine(x: Array32, weight: Array32, bias: Array32) -> Array32:
    """X (n, K) @ weight (K, M) + bias (M,)."""
    out = np.empty((len(x), weight.shape[1]), np.float32)
    for i in range(len(x)):
        out[i] = bias
    add_product(x, weight, out)
    return out


@compiled
def silu(x: Array32) -> None:
    """Replace x (n, K) by x σ(x)."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            value = np.float64(x[i, k])
            fall = gaussian(2.0 * abs(value))
            share = (1.0 if value >= 0.0 else fall) / (1.0 + fall)
            x[i, k] = np.float32(value * share)


@compiled
def layer_norm(x: Array32, weight: Array32, bias: Array32, epsilon: float) -> None:
    """Replace the rows of x (n, K) by ones of mean 0 and variance 1, scaled and shifted."""
    K = x.shape[1]
    for i in range(len(x)):
        mean = square = 0.0
        for k in range(K):
            mean += x[i, k]
        mean /= K
        for k in range(K):
            square += (x[i, k] - mean) ** 2
        inverse = 1.0 / math.sqrt(square / K + epsilon)
        for k in range(K):
            x[i, k] = np.float32((x[i, k] - mean) * inverse * weight[k] + bias[k])
