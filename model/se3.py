"""Poses: conversion to PyPose, retraction, angles, and the closed-form rotation."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pypose as pp
import torch
from torch import Tensor


def pose_matrix(rotation: Tensor, translation: Tensor) -> Tensor:
    """(…, 3, 3) and (…, 3) to (…, 4, 4)."""
    batch = rotation.shape[:-2]
    T = torch.zeros(*batch, 4, 4, dtype=rotation.dtype, device=rotation.device)
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def retract(T: Tensor, delta: Tensor) -> Tensor:
    """Exp(δ) T, the update of both inner loops: δ = (ρ, φ) acts on the left, in PyPose's order.

    Args:
        T: (B, 4, 4).
        delta: (B, 6), translation part first.

    Returns:
        (B, 4, 4), differentiable in both arguments.
    """
    step: Tensor = pp.se3(delta).Exp().matrix()
    return step @ T


def pose_log(T: Tensor) -> Tensor:
    """Log T as (B, 6), translation part first.

    Computed in float64: PyPose's logarithm loses digits near the identity in float32.
    """
    log: Tensor = pp.mat2SE3(T.double(), check=False).Log().tensor()
    return log.to(T.dtype)


def inverse(T: Tensor) -> Tensor:
    """T⁻¹ of (…, 4, 4) without a linear solve."""
    R_t = T[..., :3, :3].transpose(-1, -2)
    return pose_matrix(R_t, -(R_t @ T[..., :3, 3:])[..., 0])


def rotation_angle(R_a: Tensor, R_b: Tensor) -> Tensor:
    """Geodesic angle between rotations (…, 3, 3), in radians.

    ‖R_a − R_b‖_F = 2√2 sin(θ/2) is exact near 0, where the usual arccos of the trace is not.
    """
    chord = torch.linalg.matrix_norm(R_a - R_b) / (2.0 * math.sqrt(2.0))
    return 2.0 * torch.asin(chord.clamp(max=1.0))


def axis_angle_rotation(axis: Tensor, angle: Tensor) -> Tensor:
    """Rotation (…, 3, 3) by ``angle`` (…) radians about ``axis`` (…, 3), any length but zero."""
    vector = torch.nn.functional.normalize(axis, dim=-1) * angle[..., None]
    rotation: Tensor = pp.so3(vector).Exp().matrix()
    return rotation


def closest_rotation(M: Tensor) -> Tensor:
    """argmax_R tr(R Mᵀ) over SO(3), for M = Σ w x zᵀ (…, 3, 3), target on the left (Kabsch).

    The sign goes to the least singular direction, so planar and mirrored clouds get a rotation.
    The gradient is PyTorch's of the SVD: it is undefined where two singular values coincide.
    """
    U, _, Vh = torch.linalg.svd(M)
    sign = torch.det(U @ Vh).sign()
    fix = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], -1)
    rotation: Tensor = (U * fix[..., None, :]) @ Vh
    return rotation


def quaternion_xyzw(R: Tensor) -> Tensor:
    """Unit quaternion (…, 4) in xyzw order with w ≥ 0, of (…, 3, 3)."""
    q: Tensor = pp.mat2SO3(R, check=False).tensor()
    q = torch.nn.functional.normalize(q, dim=-1)
    return torch.where(q[..., 3:] < 0, -q, q)


def rotation_from_quaternion(q: Tensor) -> Tensor:
    """Rotation (…, 3, 3) of a unit quaternion (…, 4) in xyzw order."""
    rotation: Tensor = pp.SO3(q).matrix()
    return rotation


def rigid(T: Tensor) -> npt.NDArray[np.float64]:
    """(4, 4) as float64 with an orthonormal rotation: float32 steps drift from SO(3)."""
    orthonormal: npt.NDArray[np.float64] = T.double().numpy().copy()
    U, _, Vh = np.linalg.svd(orthonormal[:3, :3])
    orthonormal[:3, :3] = U @ Vh
    return orthonormal
