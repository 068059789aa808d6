"""How much a shape looks like itself after a rotation: what makes its pose ambiguous."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.se3 import closest_rotation
from model.search.so3_grid import so3_grid
from training.data.seeding import Stream, numpy_generator

FloatArray = npt.NDArray[np.float32]

LENGTHSCALE = 0.1
SMALLEST_ANGLE_DEGREES = 30.0

# Blurring the grid look-up over this much keeps a peak visible between two of its rotations.
_COARSE_LENGTHSCALE = 0.15
_GRID_REACH = 1.1
_GRID_CELLS = 24
# (starts, steps): the best starts of the coarse search climb first, the best of those go on.
_CLIMBS = ((8, 1), (3, 4))


def self_similarity(points: Tensor, samples: int = 256, step_deg: float = 20.0) -> float:
    """Best cosine similarity of a cloud with itself under a rotation of 30° or more.

    ρ(R) = ⟨A, R B⟩ / √(⟨A,A⟩⟨B,B⟩) with the RBF kernel of ℓ = 0.1, between two disjoint samples A
    and B of the cloud about its centroid, without the terms of a point with itself. An axially
    symmetric vase scores about 1, up to sampling noise of a few hundredths either way.

    Args:
        points: (P, 3) in the unit sphere.
        samples: size of A and of B; less where P < 2 × samples.
        step_deg: spacing of the first, coarse search over SO(3).

    Returns:
        The score; the same for the same points every time.
    """
    # In NumPy: PyTorch would split these small arrays over threads, which takes longer.
    centred = points.float().numpy() - points.float().mean(0).numpy()
    order = numpy_generator(0, Stream.SAMPLING).permutation(len(points))
    n = min(samples, len(points) // 2)
    a, b = centred[order[:n]], centred[order[n : 2 * n]]
    rotations = so3_grid(step_deg).numpy()
    rotations = rotations[_away(rotations)]
    scores = _field_scores(a, b, rotations)
    peak = 0.0
    for starts, steps in _CLIMBS:
        rotations = rotations[np.argsort(-scores)[:starts]]
        for _ in range(steps):
            weights = _kernel(a, b @ rotations.swapaxes(-1, -2))
            scores = weights.sum((-1, -2)) * _away(rotations)
            peak = max(peak, float(scores.max()))
            rotations = closest_rotation(torch.from_numpy(a.T @ weights @ b)).numpy()
    return peak / math.sqrt(_squared_norm(a) * _squared_norm(b))


def _away(rotations: FloatArray) -> npt.NDArray[np.bool_]:
    """Which of (G, 3, 3) aren't near the identity: climbing back to it is no symmetry."""
    trace = np.trace(rotations, axis1=-2, axis2=-1)
    away: npt.NDArray[np.bool_] = trace <= 1.0 + 2.0 * math.cos(
        math.radians(SMALLEST_ANGLE_DEGREES)
    )
    return away


def _field_scores(a: FloatArray, b: FloatArray, rotations: FloatArray) -> FloatArray:
    """⟨A, R B⟩ for every rotation, by looking B up in a grid that holds A's blurred density.

    The Gaussian is separable, so the grid is a matrix product; in slices, too small for BLAS to
    split over threads.
    """
    axis = np.linspace(-_GRID_REACH, _GRID_REACH, _GRID_CELLS, dtype=np.float32)
    blurred = np.exp(-((a[:, :, None] - axis) ** 2) / (2.0 * _COARSE_LENGTHSCALE**2))
    x, y, z = blurred.transpose(1, 2, 0)
    field = ((x[:, None] * y[None]) @ z.T).reshape(-1)
    turned = b @ rotations.swapaxes(-1, -2)
    turned = (turned + _GRID_REACH) * ((_GRID_CELLS - 1) / (2.0 * _GRID_REACH)) + 0.5
    cell = np.clip(turned, 0, _GRID_CELLS - 1, out=turned).astype(np.int32)
    index = (cell[..., 0] * _GRID_CELLS + cell[..., 1]) * _GRID_CELLS + cell[..., 2]
    scores: FloatArray = field[index].sum(-1)
    return scores


def _squared_norm(a: FloatArray) -> float:
    """⟨A,A⟩ as two independent samples would give it: the diagonal out, the rest scaled up."""
    n = len(a)
    return (float(_kernel(a, a).sum()) - n) * n / (n - 1)


def _kernel(a: FloatArray, b: FloatArray) -> FloatArray:
    """exp(−‖a − b‖² / 2ℓ²) of (n, 3) and (…, m, 3) as (…, n, m)."""
    squares = (a * a).sum(-1)[:, None] + (b * b).sum(-1)[..., None, :]
    exponent = (squares - 2.0 * (a @ b.swapaxes(-1, -2))) * np.float32(-0.5 / LENGTHSCALE**2)
    # Below e⁻³⁰ the exponential is denormal or nothing, and slow.
    values: FloatArray = np.exp(np.maximum(exponent, -30.0, out=exponent), out=exponent)
    return values
