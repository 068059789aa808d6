"""Second derivatives of ⟨X, hZ⟩ on SE(3): the Newton polish and what the pose is worth."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.inner_loop.near_objective import NearPairs
from model.kernel.feature_kernel import feature_kernel
from model.se3 import retract

_NEWTON_STEPS = 10
_TRIES = 6


@dataclass(frozen=True, slots=True)
class PoseCurvature:
    """⟨X, Exp(δ) h Z⟩ to second order in δ = (ρ, φ), translation part first, in float64.

    Attributes:
        value: ⟨X, hZ⟩.
        gradient: (6,).
        hessian: (6, 6); negative definite at a maximum.
        per_pair: (M, k, 6) each pair's share of the gradient.
    """

    value: Tensor
    gradient: Tensor
    hessian: Tensor
    per_pair: Tensor

    @classmethod
    def of(cls, pairs: NearPairs, T: Tensor, lengthscale: Tensor) -> PoseCurvature:
        """Differentiate at one pose.

        Args:
            pairs: a batch of one, in float64.
            T: (1, 4, 4) float64.
            lengthscale: (1,) float64.
        """
        R, t = T[0, :3, :3], T[0, :3, 3]
        y = pairs.z[0] @ R.T + t
        r = pairs.x[0] - y[:, None]
        y = y[:, None].expand_as(r)
        ell2 = lengthscale[0].square()
        rbf = torch.exp(r.square().sum(-1) / (-2.0 * ell2)) * pairs.weight[0]
        kappa, slope, bend, s_gradient, s_hessian = _feature_part(pairs, T, rbf)
        # −∇u of u = ‖x − Exp(δ)y‖²/2ℓ².
        pull = torch.cat([r, torch.linalg.cross(y, r)], -1) / ell2
        per_pair = (rbf * kappa)[..., None] * pull + (rbf * slope)[..., None] * s_gradient
        hessian = (
            _weighted_outer(rbf * kappa, pull, pull)
            - _distance_hessian(rbf * kappa, r, y) / ell2
            + _symmetric(_weighted_outer(rbf * slope, pull, s_gradient)) * 2.0
            + _weighted_outer(rbf * bend, s_gradient, s_gradient)
        )
        hessian[3:, 3:] += s_hessian
        return cls((rbf * kappa).sum(), per_pair.sum((0, 1)), hessian, per_pair)


def _feature_part(
    pairs: NearPairs, T: Tensor, rbf: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """κ, κ', κ'' (M, k); ∇s (M, k, 6); Σ v ∇²s (3, 3)."""
    if pairs.turning is None:
        one, zero = torch.ones_like(rbf), torch.zeros_like(rbf)
        return one, zero, zero, rbf.new_zeros(*rbf.shape, 6), rbf.new_zeros(3, 3)
    R = T[:, :3, :3]
    kappa, slope, bend = feature_kernel(pairs.kernel).evaluate(pairs.feature_product(R)[0])
    turned = pairs.turning[0] @ R[0].T
    torque = torch.stack(
        [
            turned[..., 2, 1] - turned[..., 1, 2],
            turned[..., 0, 2] - turned[..., 2, 0],
            turned[..., 1, 0] - turned[..., 0, 1],
        ],
        -1,
    )
    total = ((rbf * slope)[..., None, None] * turned).sum((0, 1))
    s_hessian = _symmetric(total) - torch.eye(3, dtype=total.dtype) * total.trace()
    return kappa, slope, bend, torch.cat([torch.zeros_like(torque), torque], -1), s_hessian


def _distance_hessian(w: Tensor, r: Tensor, y: Tensor) -> Tensor:
    """ℓ² Σ w ∇²u: how the distances bend, (6, 6)."""
    mass, eye = w.sum(), torch.eye(3, dtype=w.dtype)
    y_sum, r_sum = (w[..., None] * y).sum((0, 1)), (w[..., None] * r).sum((0, 1))
    yy, ry = _weighted_outer(w, y, y), _weighted_outer(w, r, y)
    H = w.new_zeros(6, 6)
    H[:3, :3] = mass * eye
    H[:3, 3:] = -_skew(y_sum) - 0.5 * _skew(r_sum)
    H[3:, :3] = H[:3, 3:].T
    H[3:, 3:] = yy.trace() * eye - yy - _symmetric(ry) + ry.trace() * eye
    return H


def _weighted_outer(w: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """Σ w a bᵀ over the pairs."""
    return (w[..., None] * a).flatten(0, 1).T @ b.flatten(0, 1)


def _symmetric(M: Tensor) -> Tensor:
    return 0.5 * (M + M.T)


def _skew(v: Tensor) -> Tensor:
    zero = torch.zeros_like(v[0])
    return torch.stack(
        [
            torch.stack([zero, -v[2], v[1]]),
            torch.stack([v[2], zero, -v[0]]),
            torch.stack([-v[1], v[0], zero]),
        ]
    )


def newton_polish(
    pairs: NearPairs, T: Tensor, lengthscale: Tensor, tolerance: float = 1e-9
) -> tuple[Tensor, bool]:
    """Damped Newton steps to the maximum of ⟨X, hZ⟩; no step that lowers it is taken.

    Args:
        pairs: near at T, a batch of one.
        T: (1, 4, 4) near the maximum.
        lengthscale: (1,).
        tolerance: a step with ‖δ‖ below this converges.

    Returns:
        the pose (1, 4, 4) in float64, and whether it converged.
    """
    pairs, T, ell = pairs.double(), T.double(), lengthscale.double()
    here = PoseCurvature.of(pairs, T, ell)
    for _ in range(_NEWTON_STEPS):
        eigenvalues, axes = torch.linalg.eigh(-here.hessian)
        # Directions along which the sum isn't concave get a short gradient step.
        stiffness = eigenvalues.abs().clamp_min(1e-6 * eigenvalues.abs().max() + 1e-30)
        delta = axes @ ((axes.T @ here.gradient) / stiffness)
        if float(delta.norm()) <= tolerance:
            return T, True
        for _ in range(_TRIES):
            there = PoseCurvature.of(pairs, retract(T, delta[None]), ell)
            if bool(there.value >= here.value):
                break
            delta = 0.25 * delta
        else:
            return T, bool(delta.norm() * 4.0**_TRIES < 1e-4)
        T, here = retract(T, delta[None]), there
    return T, bool(delta.norm() < 1e-4)
