"""The exact objective on the few hypotheses that the search leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.cloud_function import CloudFunction
from model.inner_loop import GradientLoop, ProcrustesLoop, Solution
from model.inner_loop.near_objective import REACH, NearObjective, NearPairs
from model.kernel import RkhsKernel
from model.search import KINDS, Candidates, selection_score, within
from model.search.selection import SELECTION_REACH
from model.settings import RegistrarSettings

# Near points for each source point: enough for three lengthscales on the reference spacing.
_NEAR = 48
_NEAR_IN_SELECTION = 24
_SELECTION_POINTS = 512
_FINALISTS = 3
# Refinement may turn a pose a little past the allowed rotation without being another answer.
_ROTATION_SLACK_DEG = 1.0


@dataclass(frozen=True, slots=True)
class Refined:
    """The winner.

    Attributes:
        solution: of the last stage, a batch of one.
        objective: that it was solved on.
        kind: where its start pose came from.
    """

    solution: Solution
    objective: NearObjective
    kind: str


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
        winner = settled.hypotheses.select(self._score(settled, self.source).argmax()[None])
        objective = self._objective(winner.T_target_source)
        solution = self.loop.minimise(objective, winner.T_target_source)
        return Refined(solution, objective, KINDS[int(winner.kind[0])])

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
        objective = NearObjective(pairs, pairs, pairs)
        moved = finalists.hypotheses.moved_to(loop.minimise(objective, T).T_target_source)
        return Candidates(moved, finalists.support)

    def _objective(self, T: Tensor) -> NearObjective:
        """What is near the winner now stays near: the last stage moves it by less than ℓ."""
        reach = (REACH + 1.0) * self.loop.lengthscale
        return NearObjective.at(self.kernel, self.target, self.source, T, reach, _NEAR)

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
