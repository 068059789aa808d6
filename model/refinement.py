"""The exact objective on the few hypotheses that the search leaves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.inner_loop import GradientLoop, InnerLoop, Solution
from model.kernel import RkhsKernel
from model.search import KINDS, Hypotheses, selection_score, within
from model.search.field_steps import field_step
from model.search.kernel_field import KernelField
from model.settings import RegistrarSettings

_SHORTLIST_POINTS = 512
_SHORTLIST_LENGTHSCALE = 0.05
_SHORTLIST_STEPS = 8
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
    """Move each candidate on a fine field, select by the exact kernel, solve the winner exactly.

    Args:
        kernel: of the RKHS.
        target: (1, N, …).
        source: (1, M, …).
        candidates: (K, …) from the search.
        loop: of the last stage.
        resolution: stretches every lengthscale for sparse clouds.
        R_centre: (3, 3) the rotation that ``max_rotation_deg`` counts from.
        max_rotation_deg: a pose beyond is refused, unless all are.
        generator: chooses the points that are selected by.
    """
    few_target = _subset(target, generator)
    few_source = _subset(source, generator)
    field = KernelField.of(target.points[0], _SHORTLIST_LENGTHSCALE * resolution)
    T = candidates.T_target_source
    for _ in range(_SHORTLIST_STEPS):
        T = field_step(field, few_source.points[0], T)
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


def _subset(cloud: CloudFunction, generator: torch.Generator) -> CloudFunction:
    order = torch.randperm(cloud.points.shape[1], generator=generator)
    return cloud.select(order[:_SHORTLIST_POINTS])
