"""The exact objective on the few hypotheses that the search leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.cloud_function import CloudFunction
from model.curvature import newton_polish
from model.inner_loop import GradientLoop, ProcrustesLoop, Solution
from model.inner_loop.near_objective import REACH, NearObjective, NearPairs
from model.kernel import RkhsKernel
from model.search import KINDS, Candidates, selection_score, within
from model.search.hypotheses import distinct
from model.search.selection import SELECTION_REACH
from model.settings import RegistrarSettings

# Near points for each source point: enough for three lengthscales on the reference spacing.
_NEAR = 48
_NEAR_IN_SELECTION = 24
_SELECTION_POINTS = 512
_FINALISTS = 4
# Finalists that end this close to a better one are the same answer.
_SAME_ANGLE_DEG, _SAME_DISTANCE = 5.0, 0.05
# Refinement may turn a pose a little past the allowed rotation without being another answer.
_ROTATION_SLACK_DEG = 1.0


@dataclass(frozen=True, slots=True)
class Refined:
    """The winner.

    Attributes:
        solution: of the last stage, a batch of one.
        objective: that it was solved on.
        kind: where its start pose came from.
        runner_ups: (F, 4, 4) the finalists that lost, best first.
    """

    solution: Solution
    objective: NearObjective
    kind: str
    runner_ups: Tensor


@dataclass(frozen=True, slots=True)
class Refinement:
    """Selects among candidates by the exact kernel, then solves exactly.

    Attributes:
        kernel: of the RKHS.
        target: (1, N, …).
        source: (1, M, …).
        loop: of the last stage.
        resolution: stretches every lengthscale for sparse clouds.
        tree: of the target's points.
    """

    kernel: RkhsKernel
    target: CloudFunction
    source: CloudFunction
    loop: GradientLoop | ProcrustesLoop
    resolution: float
    tree: KDTree

    def refine(
        self,
        candidates: Candidates,
        R_centre: Tensor,
        max_rotation_deg: float,
        generator: torch.Generator,
    ) -> Refined:
        """Score all on some points, solve the finalists, solve the winner to the end.

        Args:
            candidates: from the search.
            R_centre: (3, 3) the rotation that ``max_rotation_deg`` counts from.
            max_rotation_deg: a pose beyond is refused, unless all are.
            generator: chooses the points that are selected by.
        """
        allowed = within(candidates.hypotheses, R_centre, max_rotation_deg + _ROTATION_SLACK_DEG)
        if bool(allowed.any()):
            candidates = candidates.select(allowed)
        score = self._score(candidates, self._subset(generator))
        finalists = candidates.select(score.topk(min(_FINALISTS, len(score))).indices)
        settled = self._settle(finalists)
        score = self._score(settled, self.source)
        order = distinct(
            settled.hypotheses.T_target_source,
            score,
            len(score),
            _SAME_ANGLE_DEG,
            _SAME_DISTANCE * self.resolution,
        )
        ranked = settled.hypotheses.select(order)
        T = ranked.T_target_source
        objective = self._objective(T[:1])
        solution = self._finish(objective, self.loop.minimise(objective, T[:1]))
        return Refined(solution, objective, KINDS[int(ranked.kind[0])], T[1:])

    def _finish(self, objective: NearObjective, solution: Solution) -> Solution:
        """A Newton polish, unless the paper's own loop is asked for."""
        if isinstance(self.loop, GradientLoop):
            return solution
        T, converged = newton_polish(
            objective.pairs, solution.T_target_source, solution.lengthscale
        )
        return replace(
            solution,
            T_target_source=T.to(solution.T_target_source.dtype),
            converged=torch.tensor([converged]),
        )

    def _score(self, candidates: Candidates, source: CloudFunction) -> Tensor:
        T, reach = candidates.hypotheses.T_target_source, SELECTION_REACH * self.resolution
        pairs = NearPairs.at(
            self.kernel, self.target, source, T, reach, _NEAR_IN_SELECTION, self.tree
        )
        return selection_score(pairs, T, candidates.support, self.resolution)

    def _settle(self, finalists: Candidates) -> Candidates:
        """A few closed-form steps of each finalist, all at once."""
        T = finalists.hypotheses.T_target_source
        loop = ProcrustesLoop(
            lengthscale=0.05 * self.resolution,
            lengthscale_end=0.035 * self.resolution,
            steps_per_level=4,
            final_steps=4,
            record=False,
        )
        reach = REACH * loop.lengthscale
        pairs = NearPairs.at(self.kernel, self.target, self.source, T, reach, _NEAR, self.tree)
        objective = NearObjective(pairs, pairs, pairs, self.target, self.source)
        moved = finalists.hypotheses.moved_to(loop.minimise(objective, T).T_target_source)
        return Candidates(moved, finalists.support)

    def _objective(self, T: Tensor) -> NearObjective:
        """What is near the winner now stays near: the last stage moves it by less than ℓ."""
        reach = (REACH + 1.0) * self.loop.lengthscale
        return NearObjective.at(self.kernel, self.target, self.source, T, reach, _NEAR, self.tree)

    def _subset(self, generator: torch.Generator) -> CloudFunction:
        order = torch.randperm(self.source.points.shape[1], generator=generator)
        return self.source.select(order[:_SELECTION_POINTS])


def last_stage(
    settings: RegistrarSettings, solver: str, resolution: float
) -> GradientLoop | ProcrustesLoop:
    """The inner loop that ends a registration, its lengthscales stretched for sparse clouds."""
    if solver == "gradient":
        loop: GradientLoop = settings.gradient
        low, high = loop.lengthscale_bounds
        return replace(
            loop,
            lengthscale=loop.lengthscale * resolution,
            lengthscale_bounds=(low * resolution, high * resolution),
        )
    procrustes = settings.procrustes
    return replace(
        procrustes,
        lengthscale=procrustes.lengthscale * resolution,
        lengthscale_end=procrustes.lengthscale_end * resolution,
    )
