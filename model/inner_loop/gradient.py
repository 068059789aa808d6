"""The paper's inner loop: gradient descent on (h, ℓ), differentiable through its steps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.inner_loop.objective import DenseObjective, Objective
from model.inner_loop.solution import Solution, Step, Stop, never
from model.kernel import InnerProducts, RkhsKernel
from model.kernel.moments import lengthscale_gradient, pose_gradient
from model.se3 import retract


@dataclass(frozen=True, slots=True)
class GradientLoop:
    """Gradient descent with momentum on d (paper, sections 4.4 and 4.5).

    Dividing by ⟨X,X⟩ + ⟨Z,Z⟩ and the factor ℓ² make one learning rate hold for every number of
    points and every lengthscale: a step is then a share of ℓ. All steps are closed-form sums, so
    the loop is differentiable by ordinary backpropagation, without autograd's second derivatives.

    Attributes:
        iterations: at most this many steps (the released code: 800).
        learning_rate: of the pose, in units of ℓ².
        lengthscale_rate_ratio: ℓ's rate is this much smaller (paper, section 4.5: 100).
        momentum: of both.
        lengthscale: ℓ to start with, in the normalised frame.
        lengthscale_bounds: ℓ stays within.
        tolerance: a step with ‖δ‖ below this ends a pair's descent.
    """

    iterations: int = 400
    learning_rate: float = 1.0
    lengthscale_rate_ratio: float = 100.0
    momentum: float = 0.9
    lengthscale: float = 0.25
    lengthscale_bounds: tuple[float, float] = (0.05, 2.0)
    tolerance: float = 1e-6

    def solve(
        self,
        kernel: RkhsKernel,
        target: CloudFunction,
        source: CloudFunction,
        T_target_source: Tensor,
    ) -> Solution:
        """See InnerLoop.solve."""
        return self.minimise(DenseObjective(kernel, target, source), T_target_source)

    def minimise(
        self, objective: Objective, T_target_source: Tensor, stop: Stop = never
    ) -> Solution:
        """See InnerLoop.minimise."""
        T = T_target_source
        ell = T.new_full((len(T),), self.lengthscale)
        velocity, ell_velocity = T.new_zeros(len(T), 6), torch.zeros_like(ell)
        active = torch.ones_like(ell, dtype=torch.bool)
        steps: list[Step] = []
        for _ in range(self.iterations):
            if stop():
                break
            descent = DistanceGradient.of(objective, T, ell)
            rate = self.learning_rate * ell.square()
            velocity = self.momentum * velocity - rate[:, None] * descent.pose
            ell_rate = rate / self.lengthscale_rate_ratio
            ell_velocity = self.momentum * ell_velocity - ell_rate * descent.lengthscale
            delta = torch.where(active[:, None], velocity, torch.zeros_like(velocity))
            steps.append(Step.of(ell, descent.products, delta))
            T = retract(T, delta)
            moved_ell = (ell + ell_velocity).clamp(*self.lengthscale_bounds)
            ell = torch.where(active, moved_ell, ell)
            active = active & (delta.detach().norm(dim=-1) > self.tolerance)
            if not bool(active.any()):
                break
        return Solution(T, ell, ~active, steps)


@dataclass(frozen=True, slots=True)
class DistanceGradient:
    """First derivatives of d in (h, ℓ), divided by ⟨X,X⟩ + ⟨Z,Z⟩.

    Attributes:
        pose: ∇_δ, (B, 6), translation part first.
        lengthscale: ∂/∂ℓ, (B,).
        products: ⟨X,X⟩, ⟨Z,Z⟩ and ⟨X,hZ⟩.
    """

    pose: Tensor
    lengthscale: Tensor
    products: InnerProducts

    @classmethod
    def of(cls, objective: Objective, T: Tensor, lengthscale: Tensor) -> DistanceGradient:
        """Evaluate at the pose T (B, 4, 4) and ℓ (B,)."""
        cross = objective.moments(T, lengthscale)
        self_target, self_source = objective.own_moments(lengthscale)
        normaliser = self_target.mass + self_source.mass
        lengthscale_slope = (
            lengthscale_gradient(self_target, lengthscale)
            + lengthscale_gradient(self_source, lengthscale)
            - 2.0 * lengthscale_gradient(cross, lengthscale)
        )
        return cls(
            -2.0 * pose_gradient(cross, lengthscale) / normaliser[:, None],
            lengthscale_slope / normaliser,
            InnerProducts(self_target.mass, self_source.mass, cross.mass),
        )
