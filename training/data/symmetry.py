"""How much a shape looks like itself after a rotation: what makes its pose ambiguous."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from model.se3 import closest_rotation, rotation_angle
from model.search.so3_grid import so3_grid
from training.data.seeding import Stream, torch_generator

LENGTHSCALE = 0.1
SMALLEST_ANGLE_DEGREES = 30.0

# Blurring the grid look-up over this much keeps a peak visible between two of its rotations.
_COARSE_LENGTHSCALE = 0.15
_GRID_REACH = 1.1
_GRID_CELLS = 24
# (starts, steps): the best starts of the coarse search climb first, the best of those go on.
_CLIMBS = ((12, 1), (4, 4))


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
    centred = points.float() - points.float().mean(0)
    order = torch.randperm(len(points), generator=torch_generator(0, Stream.SAMPLING))
    n = min(samples, len(points) // 2)
    a, b = centred[order[:n]], centred[order[n : 2 * n]]
    rotations = so3_grid(step_deg)
    rotations = rotations[_away(rotations)]
    scores = _field_scores(a, b, rotations)
    peak = torch.tensor(0.0)
    for starts, steps in _CLIMBS:
        rotations = rotations[scores.topk(min(starts, len(rotations))).indices]
        for _ in range(steps):
            weights = _kernel(a, b @ rotations.transpose(-1, -2))
            scores = weights.sum((-1, -2)) * _away(rotations)
            peak = torch.maximum(peak, scores.max())
            rotations = closest_rotation(a.T @ weights @ b)
    return float(peak) / math.sqrt(_squared_norm(a) * _squared_norm(b))


def _away(rotations: Tensor) -> Tensor:
    """Which of (G, 3, 3) aren't near the identity: climbing back to it is no symmetry."""
    return rotation_angle(rotations, torch.eye(3)) >= math.radians(SMALLEST_ANGLE_DEGREES)


def _field_scores(a: Tensor, b: Tensor, rotations: Tensor) -> Tensor:
    """⟨A, R B⟩ for every rotation, by looking B up in a grid that holds A's blurred density.

    The Gaussian is separable, so the grid is one matrix product.
    """
    axis = torch.linspace(-_GRID_REACH, _GRID_REACH, _GRID_CELLS)
    blurred = torch.exp(-((a[:, :, None] - axis) ** 2) / (2.0 * _COARSE_LENGTHSCALE**2))
    x, y, z = blurred.unbind(1)
    plane = (x[:, :, None] * y[:, None, :]).reshape(len(a), -1)
    field = (plane.T @ z).reshape(-1)
    turned = b @ rotations.transpose(-1, -2)
    cell = (turned + _GRID_REACH) * ((_GRID_CELLS - 1) / (2.0 * _GRID_REACH))
    cell = cell.round_().clamp_(0, _GRID_CELLS - 1).long()
    index = (cell[..., 0] * _GRID_CELLS + cell[..., 1]) * _GRID_CELLS + cell[..., 2]
    return field[index].sum(-1)


def _squared_norm(a: Tensor) -> float:
    """⟨A,A⟩ as two independent samples would give it: the diagonal out, the rest scaled up."""
    n = len(a)
    return (float(_kernel(a, a).sum()) - n) * n / (n - 1)


def _kernel(a: Tensor, b: Tensor) -> Tensor:
    """exp(−‖a − b‖² / 2ℓ²) of (n, 3) and (…, m, 3) as (…, n, m)."""
    squares = (a * a).sum(-1)[:, None] + (b * b).sum(-1)[..., None, :]
    distance = squares.sub_(a @ b.transpose(-1, -2), alpha=2.0)
    # Below e⁻³⁰ the exponential is denormal or nothing, and slow.
    return distance.mul_(-0.5 / LENGTHSCALE**2).clamp_(min=-30.0).exp_()
