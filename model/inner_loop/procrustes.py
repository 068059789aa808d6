"""The closed-form inner loop: minorise ⟨X, hZ⟩, maximise by one SVD, anneal ℓ (design: MM)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.inner_loop.objective import DenseObjective, Objective
from model.inner_loop.solution import Solution, Step, Stop, never
from model.kernel import InnerProducts, RkhsKernel
from model.kernel.moments import PoseMoments
from model.se3 import closest_rotation, pose_log, pose_matrix, retract

_LONGEST_STRETCH = 8.0
# A step below this share of ℓ has converged.
_CLOSE = 5e-3


@dataclass(frozen=True, slots=True)
class ProcrustesLoop:
    """Kernel-weighted Procrustes steps while ℓ shrinks.

    A step maximises Σ w(−‖x − Ry − t‖²/2ℓ²) + v f·Rg in closed form. Steps are stretched as long
    as ⟨X, hZ⟩ at the same ℓ grows, and taken back where it falls, so no step makes d worse.

    Attributes:
        lengthscale: ℓ to start with, in the normalised frame.
        lengthscale_end: ℓ̂.
        anneal: ℓ's factor from one level to the next.
        steps_per_level: at most this many steps at each ℓ but the last.
        final_steps: at most this many steps at ℓ̂.
        stretch: growth of the step's factor after a success.
        tolerance: a step with ‖δ‖ below this ends the loop; one below ℓ/200 counts as converged.
        record: keep every step; it costs ⟨X,X⟩ and ⟨Z,Z⟩ at each ℓ.
    """

    lengthscale: float = 0.25
    lengthscale_end: float = 0.02
    anneal: float = 0.7
    steps_per_level: int = 4
    final_steps: int = 30
    stretch: float = 1.5
    tolerance: float = 1e-5
    record: bool = True

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
        steps: list[Step] = []
        for level in self.lengthscales():
            ell = T.new_full((len(T),), level)
            last = level == self.lengthscale_end
            count = self.final_steps if last else self.steps_per_level
            climb = self._climb(objective, T, ell, count, stop)
            T = climb.T_target_source
            if self.record:
                xx, zz = (own.mass for own in objective.own_moments(ell))
                steps += [
                    Step.of(ell, InnerProducts(xx, zz, xz), delta) for xz, delta in climb.steps
                ]
            if stop():
                break
        return Solution(T, ell, climb.converged, steps)

    def lengthscales(self) -> list[float]:
        """The annealing schedule, from ``lengthscale`` down to ``lengthscale_end``."""
        levels, level = [], self.lengthscale
        while level > self.lengthscale_end * 1.001:
            levels.append(level)
            level *= self.anneal
        return [*levels, self.lengthscale_end]

    def _climb(
        self, objective: Objective, T: Tensor, ell: Tensor, count: int, stop: Stop
    ) -> _Climb:
        """Guarded, stretched steps at one ℓ."""
        steps: list[tuple[Tensor, Tensor]] = []
        value, delta = _propose(objective, T, ell)
        factor = torch.ones_like(ell)
        for _ in range(count):
            size = delta.detach().norm(dim=-1)
            steps.append((value, factor[:, None] * delta))
            if bool((size <= self.tolerance).all()) or stop():
                break
            T_try = retract(T, factor[:, None] * delta)
            value_try, delta_try = _propose(objective, T_try, ell)
            better = value_try >= value
            T = torch.where(better[:, None, None], T_try, T)
            value = torch.where(better, value_try, value)
            delta = torch.where(better[:, None], delta_try, delta)
            # A plain step is a guaranteed ascent for the RBF part: back to it before halving.
            smaller = torch.where(factor > 1.0, torch.ones_like(factor), 0.5 * factor)
            larger = (self.stretch * factor).clamp(max=_LONGEST_STRETCH)
            factor = torch.where(better, larger, smaller)
        return _Climb(T, delta.detach().norm(dim=-1) <= self._close(ell), steps)

    def _close(self, ell: Tensor) -> Tensor:
        """Float32 can't tell poses apart whose step is below this: ⟨X, hZ⟩ is flat there."""
        return (_CLOSE * ell).clamp_min(self.tolerance)


@dataclass(frozen=True, slots=True)
class _Climb:
    """Where the steps at one ℓ ended, and ⟨X, hZ⟩ with δ before each."""

    T_target_source: Tensor
    converged: Tensor
    steps: list[tuple[Tensor, Tensor]]


def _propose(objective: Objective, T: Tensor, ell: Tensor) -> tuple[Tensor, Tensor]:
    """⟨X, hZ⟩ (B,) and the closed-form step δ (B, 6) at T."""
    moments = objective.moments(T, ell)
    return moments.mass, pose_log(procrustes_step(moments, ell))


def procrustes_step(moments: PoseMoments, lengthscale: Tensor) -> Tensor:
    """The minoriser's maximum as a left increment (B, 4, 4) (design, section 3).

    Where no kernel value is left there is nothing to maximise: the increment is the identity.
    """
    empty = moments.mass <= torch.finfo(moments.mass.dtype).tiny * 1e6
    mass = torch.where(empty, torch.ones_like(moments.mass), moments.mass)
    x, y = moments.mass_x / mass[:, None], moments.mass_y / mass[:, None]
    centred = moments.outer - mass[:, None, None] * x[:, :, None] * y[:, None, :]
    M = centred / lengthscale.square()[:, None, None] + moments.feature_outer
    identity = torch.eye(3, dtype=M.dtype, device=M.device).expand_as(M)
    R = closest_rotation(torch.where(empty[:, None, None], identity, M))
    t = x - (R @ y[..., None])[..., 0]
    t = torch.where(empty[:, None], torch.zeros_like(t), t)
    return pose_matrix(R, t)
