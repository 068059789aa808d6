"""How well the clouds determine the pose: information and covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.curvature import PoseCurvature
from model.inner_loop.near_objective import NearPairs

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Of δ = (ρ, φ), T = Exp(δ) T̂ about the target's centroid, along the target's axes.

    Attributes:
        covariance: (6, 6); ρ first, in the input's unit, then φ in radians.
        information: (6, 6), its inverse.
    """

    covariance: FloatArray
    information: FloatArray

    @classmethod
    def of(
        cls, pairs: NearPairs, targets: int, T: Tensor, lengthscale: Tensor, scale: float
    ) -> Uncertainty:
        """Sandwich estimate at the answer.

        The curvature A says how stiff ⟨X, hZ⟩ is, the spread B of the points' own pulls how much
        they disagree; A⁻¹BA⁻¹ is the covariance of where their sum is largest. It is that of
        clouds sampled independently of each other; clouds that share their points are known better.

        Args:
            pairs: near at the answer, a batch of one.
            targets: number N of target points.
            T: (1, 4, 4) in the normalised frame.
            lengthscale: (1,).
            scale: the frame's unit in the input's.
        """
        curvature = PoseCurvature.of(pairs.double(), T.double(), lengthscale.double())
        values, axes = torch.linalg.eigh(-curvature.hessian)
        stiffest = float(values[-1].clamp_min(1e-30))
        # An undetermined direction gets a large variance, not an infinite one.
        stiffness = values.clamp_min(1e-4 * stiffest)
        A_inverse = axes @ torch.diag(stiffness.reciprocal()) @ axes.T
        B = _pull_spread(curvature.per_pair, pairs.index[0], targets)
        C = A_inverse @ B @ A_inverse
        unit = torch.diag(torch.tensor([scale] * 3 + [1.0] * 3, dtype=torch.float64))
        covariance = (unit @ C @ unit).numpy()
        return cls(
            covariance=0.5 * (covariance + covariance.T),
            information=np.linalg.pinv(covariance, hermitian=True),
        )


def _pull_spread(per_pair: Tensor, index: Tensor, targets: int) -> Tensor:
    """Variance of the summed pulls over both samplings, as of a two-sample U-statistic.

    Σ_j s_j s_jᵀ + Σ_i t_i t_iᵀ − Σ_ij p_ij p_ijᵀ: a pair belongs to one point of each cloud and
    would otherwise count twice.
    """
    flat = per_pair.flatten(0, 1)
    by_source = per_pair.sum(1)
    by_target = torch.zeros(targets, 6, dtype=flat.dtype)
    by_target.index_add_(0, index.flatten(), flat)
    spread = by_source.T @ by_source + by_target.T @ by_target - flat.T @ flat
    values, axes = torch.linalg.eigh(spread)
    floor = 1e-12 * values[-1].clamp_min(1e-30)
    floored: Tensor = axes @ torch.diag(values.clamp_min(float(floor))) @ axes.T
    return floored
