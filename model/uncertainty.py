"""How well the clouds determine the pose: information and covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Of δ = (ρ, φ), T = Exp(δ) T̂ about the target's centroid, along the target's axes.

    Attributes:
        covariance: (6, 6); ρ first, then φ in radians.
        information: (6, 6), its inverse.
    """

    covariance: FloatArray
    information: FloatArray

    @classmethod
    def sandwich(cls, stiffness: FloatArray, spread: FloatArray) -> Uncertainty:
        """A⁻¹BA⁻¹: the covariance of where a sum over both samplings is largest.

        It is that of clouds sampled independently of each other; clouds that share their points
        are known better.

        Args:
            stiffness: (6, 6) A, how stiff the sum is: its negative Hessian.
            spread: (6, 6) B, the variance of its gradient.
        """
        values, axes = np.linalg.eigh(stiffness)
        stiffest = max(float(values[-1]), 1e-30)
        # An undetermined direction gets a large variance, not an infinite one.
        inverse = (axes / np.maximum(values, 1e-4 * stiffest)) @ axes.T
        return cls._of(inverse @ spread @ inverse)

    def in_unit(self, scale: float) -> Uncertainty:
        """The same with lengths in another unit, of which this one's is ``scale``."""
        unit = np.diag([scale] * 3 + [1.0] * 3)
        return self._of(unit @ self.covariance @ unit)

    @classmethod
    def _of(cls, covariance: FloatArray) -> Uncertainty:
        symmetric = 0.5 * (covariance + covariance.T)
        # Inverted between units that make its axes alike: metres and radians may differ greatly.
        size = np.sqrt(np.maximum(np.diag(symmetric), 1e-300))
        information = np.linalg.pinv(symmetric / np.outer(size, size), hermitian=True)
        return cls(symmetric, information / np.outer(size, size))


def pull_spread(per_pair: Tensor, index: Tensor, targets: int) -> Tensor:
    """Variance of the summed pulls over both samplings, as of a two-sample U-statistic.

    Σ_j s_j s_jᵀ + Σ_i t_i t_iᵀ − Σ_ij p_ij p_ijᵀ: a pair belongs to one point of each cloud and
    would otherwise count twice.

    Args:
        per_pair: (M, k, 6).
        index: (M, k) which of the target's points each is.
        targets: number N of target points.
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
