"""⟨X, hZ⟩ as an inner loop sees it: sums over all pairs of points, or over near ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from model.cloud_function import CloudFunction
from model.kernel import RkhsKernel
from model.kernel.moments import PoseMoments


class Objective(Protocol):
    """What a loop needs of a batch of B pairs."""

    def moments(self, T_target_source: Tensor, lengthscale: Tensor) -> PoseMoments:
        """Of ⟨X, hZ⟩ at poses (B, 4, 4) and ℓ (B,)."""
        ...

    def own_moments(self, lengthscale: Tensor) -> tuple[PoseMoments, PoseMoments]:
        """Of ⟨X, X⟩ and of ⟨Z, Z⟩ at ℓ (B,)."""
        ...


@dataclass(frozen=True, slots=True)
class DenseObjective:
    """Every pair of points, as the paper's double sum: exact, differentiable, O(NM).

    Attributes:
        kernel: of the RKHS.
        target: N points each.
        source: M points each.
    """

    kernel: RkhsKernel
    target: CloudFunction
    source: CloudFunction

    def moments(self, T_target_source: Tensor, lengthscale: Tensor) -> PoseMoments:
        """See Objective."""
        R, t = T_target_source[:, :3, :3], T_target_source[:, :3, 3]
        return self._between(self.target, self.source.transformed(R, t), lengthscale)

    def own_moments(self, lengthscale: Tensor) -> tuple[PoseMoments, PoseMoments]:
        """See Objective."""
        return (
            self._between(self.target, self.target, lengthscale),
            self._between(self.source, self.source, lengthscale),
        )

    def _between(
        self, target: CloudFunction, moved: CloudFunction, lengthscale: Tensor
    ) -> PoseMoments:
        terms = self.kernel.terms(target, moved, lengthscale)
        return PoseMoments.of(self.kernel, target, moved, terms)
