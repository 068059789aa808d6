"""Agreement among hypotheses: independent matches that name the same pose vouch for it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from model.se3 import closest_rotation, pose_matrix
from model.search.hypotheses import distinct

# Two poses within about these of each other name the same one.
ANGLE_DEG = 15.0
DISTANCE = 0.15
# The distance is meant for clouds of about this spacing; it is stretched for sparser ones.
_REFERENCE_SPACING = 0.1


def voted_poses(T: Tensor, keep: int, spacing: float) -> Tensor:
    """The poses among (V, 4, 4) that most others stand near, each the mean of those, (K, 4, 4).

    Args:
        T: candidates and voters alike.
        keep: at most this many, best first.
        spacing: of the clouds.
    """
    resolution = max(1.0, spacing / _REFERENCE_SPACING)
    votes = support(T, T, resolution)
    best = distinct(T, votes, keep, ANGLE_DEG, DISTANCE * resolution)
    return consensus(T[best], T, resolution)


def support(T: Tensor, voters: Tensor, resolution: float = 1.0) -> Tensor:
    """How many voters stand near each pose, (K,).

    A wrong match is wrong in its own way, a right one agrees with all other right ones: this finds
    the right pose where the kernel sum, under a crop, prefers another (see the selection).

    Args:
        T: (K, 4, 4).
        voters: (V, 4, 4).
        resolution: stretches the distance for sparse clouds.

    Returns:
        a sum of Gaussians, at most V; 0 where nobody votes.
    """
    if len(voters) == 0:
        return T.new_zeros(len(T))
    return _nearness(T, voters, ANGLE_DEG, DISTANCE * resolution).sum(1)


def consensus(T: Tensor, voters: Tensor, resolution: float = 1.0) -> Tensor:
    """Mean of the voters near each pose, (K, 4, 4): each match is only roughly right.

    Args:
        T: (K, 4, 4).
        voters: (V, 4, 4), at least one of them near each pose.
        resolution: stretches the distance for sparse clouds.
    """
    weight = _nearness(T, voters, 0.7 * ANGLE_DEG, 0.7 * DISTANCE * resolution)
    weight = weight / weight.sum(1, keepdim=True)
    turning = (weight @ voters[:, :3, :3].flatten(1)).reshape(-1, 3, 3)
    return pose_matrix(closest_rotation(turning), weight @ voters[:, :3, 3])


def _nearness(T: Tensor, voters: Tensor, angle_deg: float, distance: float) -> Tensor:
    """(K, V) Gaussians of the angle and of the distance between poses."""
    trace = T[:, :3, :3].flatten(1) @ voters[:, :3, :3].flatten(1).T
    # 3 − tr(RᵀS) = 2(1 − cos θ) ≈ θ².
    turn = (3.0 - trace) / (2.0 * math.radians(angle_deg) ** 2)
    shift = torch.cdist(T[:, :3, 3], voters[:, :3, 3]) / distance
    return torch.exp(-turn - 0.5 * shift.square())
