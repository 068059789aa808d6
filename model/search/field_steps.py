"""Scoring and moving many pose hypotheses on a kernel field."""

from __future__ import annotations

import torch
from torch import Tensor

from model.se3 import closest_rotation, pose_matrix
from model.search.kernel_field import KernelField


def field_score(field: KernelField, z: Tensor, T: Tensor) -> Tensor:
    """⟨X, hZ⟩ of the geometric kernel, (K,), for source points (M, 3) and poses (K, 4, 4)."""
    return field.look_up(_moved(z, T))[0].sum(-1)


def field_step(field: KernelField, z: Tensor, T: Tensor) -> Tensor:
    """One closed-form Procrustes step of every hypothesis, (K, 4, 4) → (K, 4, 4).

    A hypothesis that has left the field keeps its pose.
    """
    found = field.look_up(_moved(z, T))
    w, wx = found[0], found[1:].permute(1, 2, 0)
    mass = w.sum(-1)
    lost = mass <= 1e-6
    safe = torch.where(lost, torch.ones_like(mass), mass)[:, None]
    x_mean = wx.sum(1) / safe
    z_mean = (w @ z) / safe
    M = wx.transpose(-1, -2) @ z - mass[:, None, None] * x_mean[:, :, None] * z_mean[:, None, :]
    M = torch.where(lost[:, None, None], torch.eye(3, dtype=M.dtype), M)
    R = closest_rotation(M)
    stepped = pose_matrix(R, x_mean - (R @ z_mean[..., None])[..., 0])
    return torch.where(lost[:, None, None], T, stepped)


def _moved(z: Tensor, T: Tensor) -> Tensor:
    return z @ T[:, :3, :3].transpose(-1, -2) + T[:, None, :3, 3]
