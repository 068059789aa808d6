"""Sums over all pairs of points from which every step on SE(3) is built.

Nothing here loops over correspondences: each moment is a matrix product with the kernel terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.kernel.rkhs import KernelTerms, RkhsKernel


@dataclass(frozen=True, slots=True)
class PoseMoments:
    """First-order information of ⟨X, hZ⟩ at the present pose; y = h z are the moved points.

    Attributes:
        mass: Σ w_ij, which is ⟨X, hZ⟩, (B,).
        mass_x: Σ w_ij x_i, (B, 3).
        mass_y: Σ w_ij y_j, (B, 3).
        outer: Σ w_ij x_i y_jᵀ, (B, 3, 3).
        feature_outer: Σ v_ij Σ_c f_ic (h g)_jcᵀ, (B, 3, 3).
        scatter: Σ w_ij ‖x_i − y_j‖², (B,).
    """

    mass: Tensor
    mass_x: Tensor
    mass_y: Tensor
    outer: Tensor
    feature_outer: Tensor
    scatter: Tensor

    @classmethod
    def of(
        cls,
        kernel: RkhsKernel,
        target: CloudFunction,
        moved: CloudFunction,
        terms: KernelTerms,
    ) -> PoseMoments:
        """Sum the kernel terms of the target and the already moved source."""
        w = terms.value
        w_x, w_y = w.sum(-1), w.sum(-2)
        f = kernel.matched_features(target)
        g = kernel.matched_features(moved)
        return cls(
            mass=w_x.sum(-1),
            mass_x=_weighted(w_x, target.points),
            mass_y=_weighted(w_y, moved.points),
            outer=target.points.transpose(-1, -2) @ (w @ moved.points),
            feature_outer=_feature_outer(f, terms.slope, g),
            scatter=(w * terms.squared_distance).sum((-1, -2)),
        )


def _weighted(weight: Tensor, points: Tensor) -> Tensor:
    return (weight[..., None, :] @ points)[..., 0, :]


def _feature_outer(f: Tensor, slope: Tensor, g: Tensor) -> Tensor:
    if f.shape[-1] == 0:
        return f.new_zeros(slope.shape[0], 3, 3)
    gathered = (slope @ g.flatten(-2)).reshape(*slope.shape[:2], *g.shape[-2:])
    return torch.einsum("bnpc,bnqc->bpq", f, gathered)


def pose_gradient(moments: PoseMoments, lengthscale: Tensor) -> Tensor:
    """∇_δ ⟨X, Exp(δ) h Z⟩ at δ = 0, (B, 6), translation part first.

    The force is Σ w (x − y)/ℓ²; the torque Σ w y×x/ℓ² + Σ v Σ_c g_c×f_c, both read off the
    antisymmetric part of the outer products.
    """
    inverse2 = lengthscale.square().reciprocal()
    force = (moments.mass_x - moments.mass_y) * inverse2[:, None]
    turning = moments.outer * inverse2[:, None, None] + moments.feature_outer
    torque = torch.stack(
        [
            turning[:, 2, 1] - turning[:, 1, 2],
            turning[:, 0, 2] - turning[:, 2, 0],
            turning[:, 1, 0] - turning[:, 0, 1],
        ],
        -1,
    )
    return torch.cat([force, torque], -1)


def lengthscale_gradient(moments: PoseMoments, lengthscale: Tensor) -> Tensor:
    """∂⟨X, hZ⟩/∂ℓ = Σ w ‖x − y‖²/ℓ³, (B,)."""
    return moments.scatter / lengthscale**3
