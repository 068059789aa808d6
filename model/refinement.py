"""The exact objective on the few hypotheses that the search leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.inner_loop import GradientLoop, InnerLoop, ProcrustesLoop, Solution
from model.kernel import RkhsKernel
from model.search import KINDS, Hypotheses, selection_score, within
from model.settings import RegistrarSettings

_SHORTLIST_POINTS = 512
_SHORTLIST_SCORED = 4
# Refinement may turn a pose a little past the allowed rotation without being another answer.
_ROTATION_SLACK_DEG = 1.0


@dataclass(frozen=True, slots=True)
class Refined:
    """The winner.

    Attributes:
        solution: of the last stage, a batch of one.
        kind: where its start pose came from.
    """

    solution: Solution
    kind: str


def refine(
    kernel: RkhsKernel,
    target: CloudFunction,
    source: CloudFunction,
    candidates: Hypotheses,
    loop: InnerLoop,
    resolution: float,
    R_centre: Tensor,
    max_rotation_deg: float,
    generator: torch.Generator,
) -> Refined:
    """Solve the exact objective for each candidate on few points, select, solve on all points.

    Args:
        kernel: of the RKHS.
        target: (1, N, …).
        source: (1, M, …).
        candidates: (K, …) from the search.
        loop: of the last stage.
        resolution: stretches every lengthscale for sparse clouds.
        R_centre: (3, 3) the rotation that ``max_rotation_deg`` counts from.
        max_rotation_deg: a pose beyond is refused, unless all are.
        generator: chooses the points of the first stage.
    """
    shortlist = _shortlist_loop(resolution)
    few_target = _subset(target, generator)
    few_source = _subset(source, generator)
    K = len(candidates)
    T = shortlist.solve(
        kernel, few_target.expand(K), few_source.expand(K), candidates.T_target_source
    ).T_target_source
    candidates = candidates.moved_to(T)
    score = selection_score(kernel, few_target, few_source, T, resolution)
    allowed = within(candidates, R_centre, max_rotation_deg + _ROTATION_SLACK_DEG)
    if bool(allowed.any()):
        score = score.masked_fill(~allowed, -torch.inf)
    best = score.topk(min(_SHORTLIST_SCORED, int((score > -torch.inf).sum()))).indices
    full = selection_score(kernel, target, source, T[best], resolution)
    winner = best[full.argmax()][None]
    solution = loop.solve(kernel, target, source, T[winner])
    return Refined(solution, KINDS[int(candidates.kind[winner])])


def last_stage(settings: RegistrarSettings, solver: str, resolution: float) -> InnerLoop:
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


def _shortlist_loop(resolution: float) -> ProcrustesLoop:
    return ProcrustesLoop(
        lengthscale=0.08 * resolution,
        lengthscale_end=0.05 * resolution,
        steps_per_level=3,
        final_steps=4,
        record=False,
    )


def _subset(cloud: CloudFunction, generator: torch.Generator) -> CloudFunction:
    order = torch.randperm(cloud.points.shape[1], generator=generator)
    return cloud.select(order[:_SHORTLIST_POINTS])
