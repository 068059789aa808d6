"""The inner loop inside training: where it starts, and what of it the gradient sees."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.inner_loop import GradientLoop, InnerLoop, ProcrustesLoop, build_inner_loop
from model.kernel import RkhsKernel
from training.curriculum import Stage

Backward = Literal["unrolled", "envelope", "detached_step"]


@dataclass(frozen=True)
class InnerSolution:
    """ĥ and ℓ̂ of a training batch.

    Attributes:
        T_target_source: (B, 4, 4), with a graph to θ only when unrolled.
        lengthscale: (B,), likewise.
        similarity: (B,) ρ there, outside the graph.
    """

    T_target_source: Tensor
    lengthscale: Tensor
    similarity: Tensor


@dataclass(frozen=True)
class BilevelSolver:
    """argmin over (h, ℓ) from the curriculum's initial error (paper, section 4.5).

    Attributes:
        inner_loop: name of the loop that solves.
        backward: ``envelope`` treats (ĥ, ℓ̂) as constants, exact at an interior optimum;
            ``unrolled`` differentiates through the last gradient steps; ``detached_step`` makes
            one gradient step between two outer steps, as the released code does.
        unrolled_steps: how many steps the gradient goes through.
        iterations: of the inner loop, at ℓ's end; the released code takes up to 800.
        anneal: ℓ's factor from one level to the next, of the ``procrustes`` loop.
        steps_per_level: at most this many steps at each ℓ but the last, of the same.
    """

    inner_loop: str = "procrustes"
    backward: Backward = "envelope"
    unrolled_steps: int = 3
    iterations: int = 40
    anneal: float = 0.7
    steps_per_level: int = 4

    def solve(
        self,
        kernel: RkhsKernel,
        target: CloudFunction,
        source: CloudFunction,
        T_start: Tensor,
        stage: Stage,
    ) -> InnerSolution:
        """Solve a batch from its start poses (B, 4, 4)."""
        loop = self._loop(stage)
        with torch.no_grad():
            solution = loop.solve(kernel, target.detach(), source.detach(), T_start)
        T, ell = solution.T_target_source.detach(), solution.lengthscale.detach()
        similarity = _similarity(kernel, target, source, T, ell)
        if self.backward == "unrolled":
            T, ell = self._unroll(kernel, target, source, T, ell, stage)
        return InnerSolution(T, ell, similarity)

    def step(
        self,
        kernel: RkhsKernel,
        target: CloudFunction,
        source: CloudFunction,
        T: Tensor,
        stage: Stage,
    ) -> InnerSolution:
        """One detached gradient step from (B, 4, 4): the released code's inner loop."""
        loop = replace(_gradient_loop(stage), iterations=1)
        with torch.no_grad():
            solution = loop.solve(kernel, target.detach(), source.detach(), T)
        T, ell = solution.T_target_source, solution.lengthscale
        return InnerSolution(T, ell, _similarity(kernel, target, source, T, ell))

    def _loop(self, stage: Stage) -> InnerLoop:
        if self.inner_loop == "gradient":
            return replace(_gradient_loop(stage), iterations=self.iterations)
        low, _ = stage.lengthscale_bounds
        loop = build_inner_loop(
            self.inner_loop,
            lengthscale=stage.lengthscale,
            lengthscale_end=low,
            anneal=self.anneal,
            steps_per_level=self.steps_per_level,
            final_steps=self.iterations,
            record=False,
        )
        assert isinstance(loop, ProcrustesLoop)
        return loop

    def _unroll(
        self,
        kernel: RkhsKernel,
        target: CloudFunction,
        source: CloudFunction,
        T: Tensor,
        ell: Tensor,
        stage: Stage,
    ) -> tuple[Tensor, Tensor]:
        # Momentum would carry the last steps past the optimum that the inner loop has found.
        loop = replace(
            _gradient_loop(stage),
            iterations=self.unrolled_steps,
            momentum=0.0,
            tolerance=0.0,
            lengthscale=float(ell.mean()),
        )
        solution = loop.solve(kernel, target, source, T)
        return solution.T_target_source, solution.lengthscale


def _gradient_loop(stage: Stage) -> GradientLoop:
    return GradientLoop(
        lengthscale=stage.lengthscale,
        lengthscale_bounds=stage.lengthscale_bounds,
        learning_rate=stage.pose_learning_rate,
        lengthscale_rate_ratio=stage.lengthscale_rate_ratio,
    )


@torch.no_grad()
def _similarity(
    kernel: RkhsKernel, target: CloudFunction, source: CloudFunction, T: Tensor, ell: Tensor
) -> Tensor:
    moved = source.transformed(T[:, :3, :3], T[:, :3, 3])
    return kernel.products(target, moved, ell).similarity
