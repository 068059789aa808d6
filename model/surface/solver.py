"""The last stage on the surface kernel: ℓ shrinks to how closely the clouds meet, then Newton."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from model.inner_loop.solution import Step
from model.kernel import InnerProducts
from model.side_by_side import Promise, run_together
from model.surface.cells import FloatArray
from model.surface.cloud import SurfaceCloud
from model.surface.curvature import SurfaceCurvature
from model.surface.descent import descend
from model.surface.meeting import Meeting
from model.surface.moments import REACH, VIEW
from model.surface.newton import newton_polish
from model.surface.overlap import overlapping
from model.surface.product import surface_norms, surface_products
from model.surface.spread import pull_spread
from model.surface.together import CorrectPair, seen_together

Stop = Callable[[], bool]

_NEWTON_STEPS = 3
_SMALL = 4000
# The last ℓ may take this many times the steps of the others to come to rest.
_LAST_STEPS = 2
_MANY, _WIDEST = 700, 2.0
# Where rough surfaces are sampled independently, few pairs lie on each other's planes, and those
# tell the pose: ℓ_n is this much sharper there. On smooth ones all do, and average their noise.
_SHARPER = 0.4
_SMOOTH, _ROUGH = 0.1, 0.16
# About the ball that a normal is fitted to.
_BLOCK = 1.5


class _Rest(NamedTuple):
    """Where the steps came to rest: pose, ℓ, ℓ_n, whether the clouds share no points, and rest."""

    T_target_source: FloatArray
    lengthscale: float
    across: float
    apart: bool
    steady: bool


@dataclass(frozen=True, slots=True)
class SurfaceLoop:
    """Gauss–Newton ascent of the surface kernel's sum; lengths are in spacings of the clouds.

    ℓ follows how far points of the one cloud lie from the other at the present pose: clouds that
    share their points meet at 0, independent samples at about half a spacing. ℓ_n follows the
    distance across the surface. Both stay within their bounds (paper, section 4.5: ℓ is optimised
    together with the pose, slowly and within bounds).

    Attributes:
        lengthscale: ℓ along the surface to start with.
        across: ℓ_n across it to start with.
        steps: at most this many at each ℓ but the last, which may take twice as many.
        rounds: of adapting ℓ.
        growth: ℓ by the median distance of near points.
        growth_across: ℓ_n by the median height of near points above the surface.
        least: lower bound of ℓ.
        least_across: lower bound of ℓ_n.
        tolerance: a step with ‖δ‖ below this ends a level.
        together: how often few points that were sampled independently get new normals and weights
            from both clouds at the present pose, and are solved again.
        overlap: points with none of the other cloud within this don't take part; 0 for all.
    """

    lengthscale: float = 0.7
    across: float = 0.25
    steps: int = 5
    rounds: int = 2
    growth: float = 1.8
    growth_across: float = 2.2
    least: float = 0.1
    least_across: float = 0.08
    tolerance: float = 1e-5
    together: int = 3
    overlap: float = 1.0

    def solve(
        self,
        target: SurfaceCloud,
        source: SurfaceCloud,
        T: FloatArray,
        stop: Stop,
        correct: CorrectPair | None = None,
    ) -> SurfaceSolution:
        """Solve from T (4, 4).

        Args:
            target: N points.
            source: M points.
            T: where to start.
            stop: asked between steps; the best pose so far is then the answer.
            correct: improves normals that are fitted to both clouds, and weighs the points.
        """
        spacing = max(target.spacing, source.spacing)
        steps: list[Step] = []
        rest = self._narrowed(*self._cut(target, source, T), T, stop, steps)
        alone = target, source
        fewer = min(len(target.arrays.points), len(source.arrays.points))
        for _ in range(self.together if fewer < _MANY and rest.apart else 0):
            if stop():
                break
            T = rest.T_target_source
            target, source = seen_together(*alone, T, correct)
            rest = self._narrowed(*self._cut(target, source, T), T, stop, steps)
        T, ell, across, _, steady = rest
        x, z = self._cut(target, source, T)
        # From afar it cut something else.
        if not (x is target and z is source):
            most = _LAST_STEPS * self.steps
            T, steady = self._level(x, z, T, ell, across, most, stop, steps)
        view, cut = x.at(VIEW * ell), REACH * ell
        rounds = 0 if stop() else _NEWTON_STEPS
        T, curvature, small = newton_polish(view, z.arrays, T, ell, across, cut, rounds)
        block = _BLOCK * spacing
        products, spread = run_together(
            lambda: surface_products(target, source, T, ell, across),
            lambda: pull_spread(view, z.arrays, T, ell, across, cut, block),
        )
        converged = (steady or small) and not stop()
        return SurfaceSolution(
            T, ell, across, converged, steps, products, curvature, spread, target, source
        )

    def _cut(
        self, target: SurfaceCloud, source: SurfaceCloud, T: FloatArray
    ) -> tuple[SurfaceCloud, SurfaceCloud]:
        """Both clouds cut to what they share at T."""
        if self.overlap == 0.0:
            return target, source
        return overlapping(target, source, T, self.overlap * max(target.spacing, source.spacing))

    def _narrowed(
        self,
        target: SurfaceCloud,
        source: SurfaceCloud,
        T: FloatArray,
        stop: Stop,
        steps: list[Step],
    ) -> _Rest:
        """Level by level, with ℓ and ℓ_n that follow how closely the clouds meet."""
        spacing, apart = max(target.spacing, source.spacing), False
        # Few points pull each other along the surface, where they don't correspond: the farther
        # the kernel reaches along it, the less.
        fewer = min(len(target.arrays.points), len(source.arrays.points))
        wide = float(np.clip((_MANY / fewer) ** 0.5, 1.0, _WIDEST))
        roughness = min(target.roughness, source.roughness)
        sharper = float(np.interp(roughness, (_SMOOTH, _ROUGH), (1.0, _SHARPER)))
        ell, across = self.lengthscale * wide * spacing, self.across * spacing
        T, steady = self._level(target, source, T, ell, across, self.steps, stop, steps)
        for left in reversed(range(self.rounds)):
            meeting = Meeting.of(target, source, T)
            if meeting is None or stop():
                break
            apart = meeting.apart
            growth = self.growth * (wide if apart else 1.0)
            growth_across = self.growth_across * (sharper if apart else 1.0)
            ell = float(np.clip(growth * meeting.distance, self.least * spacing, ell))
            across = min(
                ell,
                float(
                    np.clip(
                        growth_across * meeting.height,
                        self.least_across * spacing,
                        self.across * spacing,
                    )
                ),
            )
            most = self.steps if left else _LAST_STEPS * self.steps
            T, steady = self._level(target, source, T, ell, across, most, stop, steps)
        return _Rest(T, ell, across, apart, steady)

    def _level(
        self,
        target: SurfaceCloud,
        source: SurfaceCloud,
        T: FloatArray,
        ell: float,
        across: float,
        most: int,
        stop: Stop,
        trace: list[Step],
    ) -> tuple[FloatArray, bool]:
        """Steps at one ℓ, recorded; tells whether they came to rest."""
        view = target.at(VIEW * ell)
        own = Promise(lambda: surface_norms(target, source, ell, across))
        # A large cloud's steps take so long that ``stop`` is asked after each two.
        at_once = most if len(source.arrays.points) <= _SMALL else 2
        steady, taken = False, 0
        while taken < most and not steady and not stop():
            found = descend(
                view.cells, view.arrays, source.arrays, T, ell, across, at_once, self.tolerance
            )
            T, steady = found.T_target_source, found.steady
            taken += at_once
            trace += [
                _step(ell, own(), value, delta)
                for value, delta in zip(found.values, found.deltas, strict=True)
            ]
        return T, steady


def _step(ell: float, own: tuple[float, float], value: float, delta: FloatArray) -> Step:
    xx, zz, xz, ells = (torch.tensor([v], dtype=torch.float64) for v in (*own, value, ell))
    return Step.of(ells, InnerProducts(xx, zz, xz), torch.from_numpy(delta)[None])


@dataclass(frozen=True, slots=True)
class SurfaceSolution:
    """ĥ and ℓ̂ on the surface kernel.

    Attributes:
        T_target_source: (4, 4).
        lengthscale: ℓ along the surface.
        across: ℓ_n.
        converged: whether the last step was below the tolerance.
        steps: one an iteration.
        products: ⟨X,X⟩, ⟨Z,Z⟩ and ⟨X,ĥZ⟩.
        curvature: at the answer.
        spread: (6, 6) variance of the gradient.
        target: with the normals and weights that it had in the end.
        source: likewise.
    """

    T_target_source: FloatArray
    lengthscale: float
    across: float
    converged: bool
    steps: list[Step]
    products: InnerProducts
    curvature: SurfaceCurvature
    spread: FloatArray
    target: SurfaceCloud
    source: SurfaceCloud
