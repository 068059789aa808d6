"""The last stage: one pose solved to the end, on the surface kernel or on the paper's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch

from model.curvature import PoseCurvature, newton_polish
from model.inner_loop import GradientLoop, ProcrustesLoop
from model.inner_loop.near_objective import REACH, NearObjective
from model.inner_loop.solution import Step
from model.kernel import InnerProducts, RkhsKernel
from model.prepared_cloud import PreparedCloud
from model.se3 import rigid
from model.settings import RegistrarSettings
from model.surface import CorrectPair, SurfaceLoop, surface_product
from model.uncertainty import Uncertainty, pull_spread

FloatArray = npt.NDArray[np.float64]
Stop = Callable[[], bool]

# Near points for each source point: enough for three lengthscales on the reference spacing.
_NEAR = 48
# The paper's lengthscales are meant for clouds of this spacing; sparser clouds stretch them.
_REFERENCE_SPACING = 0.12


@dataclass(frozen=True, slots=True)
class Solved:
    """ĥ and ℓ̂, in the normalised frame.

    Attributes:
        T_target_source: (4, 4).
        lengthscale: ℓ̂.
        converged: whether the last step was below the tolerance.
        steps: one an iteration.
        products: ⟨X,X⟩, ⟨Z,Z⟩ and ⟨X,ĥZ⟩ on the kernel that was solved on.
        uncertainty: of the pose, in the frame's unit.
        similarity_at: ρ at other poses (4, 4), at ℓ̂.
    """

    T_target_source: FloatArray
    lengthscale: float
    converged: bool
    steps: list[Step]
    products: InnerProducts
    uncertainty: Uncertainty
    similarity_at: Callable[[FloatArray], float]

    @property
    def similarity(self) -> float:
        """ρ at ĥ and ℓ̂."""
        return self.products.similarity.item()


class LastStage(Protocol):
    """Solves from one pose."""

    def solve(
        self, target: PreparedCloud, source: PreparedCloud, T: FloatArray, stop: Stop
    ) -> Solved:
        """Solve from T (4, 4); when told to stop, answer with the best so far."""
        ...


@dataclass(frozen=True, slots=True)
class SurfaceStage:
    """All points, on the surface kernel.

    Attributes:
        loop: see SurfaceLoop.
        features: whether κ(f·g) takes part, or the metric alone.
        correct: improves normals that are fitted to both clouds, and weighs their points.
    """

    loop: SurfaceLoop
    features: bool
    correct: CorrectPair | None

    def solve(
        self, target: PreparedCloud, source: PreparedCloud, T: FloatArray, stop: Stop
    ) -> Solved:
        """See LastStage."""
        x, z = target.dense, source.dense
        if self.features:
            x, z = target.dense_with_features(), source.dense_with_features()
        found = self.loop.solve(x, z, T, stop, self.correct)
        own = found.products

        def similarity_at(T_other: FloatArray) -> float:
            ell, across = found.lengthscale, found.across
            value = surface_product(found.target, found.source, T_other, ell, across)
            cross = torch.full_like(own.target, value)
            return InnerProducts(own.target, own.source, cross).similarity.item()

        return Solved(
            found.T_target_source,
            found.lengthscale,
            found.converged,
            found.steps,
            own,
            Uncertainty.sandwich(-found.curvature.hessian, found.spread),
            similarity_at,
        )


@dataclass(frozen=True, slots=True)
class PaperStage:
    """The points of the search, on the paper's kernel, by one of its inner loops.

    Attributes:
        kernel: of the RKHS.
        loop: closed form, ended by Newton steps, or the paper's gradient descent as it is.
    """

    kernel: RkhsKernel
    loop: GradientLoop | ProcrustesLoop

    def solve(
        self, target: PreparedCloud, source: PreparedCloud, T: FloatArray, stop: Stop
    ) -> Solved:
        """See LastStage."""
        spacing = max(target.sparse.spacing, source.sparse.spacing)
        loop = _stretched(self.loop, max(1.0, spacing / _REFERENCE_SPACING))
        start = torch.from_numpy(T).float()[None]
        # What is near now stays near: this stage moves the pose by less than ℓ.
        reach = (REACH + 1.0) * loop.lengthscale
        objective = NearObjective.at(
            self.kernel, target.function, source.function, start, reach, _NEAR
        )
        solution = loop.minimise(objective, start, stop)
        if isinstance(loop, ProcrustesLoop) and not stop():
            polished, converged = newton_polish(
                objective.pairs, solution.T_target_source, solution.lengthscale
            )
            solution = replace(
                solution,
                T_target_source=polished.float(),
                converged=torch.tensor([converged]),
            )
        ell = solution.lengthscale
        pairs = objective.pairs.double()
        curvature = PoseCurvature.of(pairs, solution.T_target_source.double(), ell.double())
        spread = pull_spread(curvature.per_pair, pairs.index[0], target.function.points.shape[1])
        own_target, own_source = objective.own_moments(ell)
        cross = objective.moments(solution.T_target_source, ell)
        products = InnerProducts(own_target.mass, own_source.mass, cross.mass)

        def similarity_at(T_other: FloatArray) -> float:
            there = torch.from_numpy(T_other).float()[None]
            other = objective.elsewhere(self.kernel, there, ell)
            return InnerProducts(products.target, products.source, other).similarity.item()

        return Solved(
            rigid(solution.T_target_source[0]),
            ell.item(),
            bool(solution.converged[0]),
            solution.steps,
            products,
            Uncertainty.sandwich(-curvature.hessian.numpy(), spread.numpy()),
            similarity_at,
        )


def last_stage(
    settings: RegistrarSettings, solver: str, kernel: RkhsKernel, correct: CorrectPair | None
) -> LastStage:
    """The stage by the solver's name."""
    if solver == "surface":
        return SurfaceStage(settings.surface, settings.surface_features, correct)
    return PaperStage(kernel, settings.gradient if solver == "gradient" else settings.procrustes)


def _stretched(
    loop: GradientLoop | ProcrustesLoop, resolution: float
) -> GradientLoop | ProcrustesLoop:
    """The loop with its lengthscales stretched for sparse clouds."""
    if isinstance(loop, GradientLoop):
        low, high = loop.lengthscale_bounds
        return replace(
            loop,
            lengthscale=loop.lengthscale * resolution,
            lengthscale_bounds=(low * resolution, high * resolution),
        )
    return replace(
        loop,
        lengthscale=loop.lengthscale * resolution,
        lengthscale_end=loop.lengthscale_end * resolution,
    )
