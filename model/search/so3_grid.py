"""Uniform rotations: super-Fibonacci spirals on the unit quaternions."""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

from model.se3 import rotation_from_quaternion

# The spirals' two irrational winding numbers (Alexa, CVPR 2022): √2 and the root of ψ⁴ = ψ + 4.
_PHI = math.sqrt(2.0)
_PSI = 1.533751168755204288118041


@lru_cache(maxsize=16)
def so3_grid(step_deg: float, max_angle_deg: float = 180.0) -> Tensor:
    """Rotations about ``step_deg`` apart, within ``max_angle_deg`` of the identity.

    Args:
        step_deg: each rotation stands for a cell of volume ``step_deg``³.
        max_angle_deg: geodesic radius of the grid.

    Returns:
        (G, 3, 3) float32, with the identity first; shared between callers, so not to be written.
    """
    n = math.ceil(math.pi**2 * 8.0 / math.radians(step_deg) ** 3)
    i = torch.arange(n, dtype=torch.float64) + 0.5
    share, turn = i / n, 2.0 * math.pi * i
    r, R = share.sqrt(), (1.0 - share).sqrt()
    alpha, beta = turn / _PHI, turn / _PSI
    q = torch.stack([r * alpha.sin(), r * alpha.cos(), R * beta.sin(), R * beta.cos()], -1)
    angle = 2.0 * torch.acos(q[:, 3].abs().clamp(max=1.0))
    inside = angle <= math.radians(max_angle_deg) + 1e-9
    identity = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)
    return rotation_from_quaternion(torch.cat([identity, q[inside]])).float()
