"""What an inner loop is given and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from torch import Tensor

from model.cloud_function import CloudFunction
from model.inner_loop.objective import Objective
from model.kernel import InnerProducts, RkhsKernel

Stop = Callable[[], bool]


def never() -> bool:
    """The answer of somebody who has time."""
    return False


@dataclass(frozen=True, slots=True)
class Step:
    """State before one step and the step's size; every entry is (B,).

    Attributes:
        lengthscale: ℓ.
        products: inner products, with d and ρ.
        rotation: angle of the step, radians.
        translation: length of the step's translation.
    """

    lengthscale: Tensor
    products: InnerProducts
    rotation: Tensor
    translation: Tensor

    @classmethod
    def of(cls, lengthscale: Tensor, products: InnerProducts, delta: Tensor) -> Step:
        """Record a step δ (B, 6), translation part first, outside the autograd graph."""
        delta = delta.detach()
        return cls(
            lengthscale.detach(),
            products.detach(),
            delta[:, 3:].norm(dim=-1),
            delta[:, :3].norm(dim=-1),
        )


@dataclass(frozen=True, slots=True)
class Solution:
    """ĥ and ℓ̂ of a batch.

    Attributes:
        T_target_source: (B, 4, 4).
        lengthscale: (B,).
        converged: (B,) whether the last step was below the tolerance.
        steps: one entry an iteration, empty where the loop was told not to record.
    """

    T_target_source: Tensor
    lengthscale: Tensor
    converged: Tensor
    steps: list[Step] = field(default_factory=list)


class InnerLoop(Protocol):
    """argmin over (h, ℓ) of d(f_X, f_hZ) from a start pose (paper, sections 4.4 and 4.5)."""

    def solve(
        self,
        kernel: RkhsKernel,
        target: CloudFunction,
        source: CloudFunction,
        T_target_source: Tensor,
    ) -> Solution:
        """Solve a batch over all pairs of points.

        Args:
            kernel: of the RKHS.
            target: N points each; masks cover N ≠ M and padding.
            source: M points each.
            T_target_source: (B, 4, 4) start poses.
        """
        ...

    def minimise(
        self, objective: Objective, T_target_source: Tensor, stop: Stop = never
    ) -> Solution:
        """Solve a batch on any objective, from start poses (B, 4, 4).

        ``stop`` is asked between steps; the answer is then the best so far.
        """
        ...
