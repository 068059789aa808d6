"""From many start poses to the few worth solving exactly: coarse to fine on kernel fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from model.search.field_steps import field_score, field_step
from model.search.hypotheses import Hypotheses, distinct
from model.search.kernel_field import KernelField


@dataclass(frozen=True, slots=True)
class SearchLevel:
    """Steps at one lengthscale, then pruning.

    Attributes:
        lengthscale: ℓ of the field, in the normalised frame.
        steps: closed-form steps of every hypothesis.
        keep: the best of them that go on.
    """

    lengthscale: float
    steps: int
    keep: int


def _default_levels() -> list[SearchLevel]:
    return [
        SearchLevel(0.25, 3, 400),
        SearchLevel(0.12, 4, 150),
        SearchLevel(0.08, 4, 150),
    ]


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How wide and how long to search.

    Attributes:
        grid_step_deg: spacing of the SO(3) grid.
        source_points: source points that score a hypothesis.
        levels: coarse to fine.
        candidates: distinct hypotheses that are solved exactly.
        merge_angle_deg: closer ones are merged, if
        merge_distance: also their translations are this close.
    """

    grid_step_deg: float = 30.0
    source_points: int = 256
    levels: Sequence[SearchLevel] = field(default_factory=_default_levels)
    candidates: int = 16
    merge_angle_deg: float = 5.0
    merge_distance: float = 0.1


def coarse_to_fine(
    hypotheses: Hypotheses,
    target: Tensor,
    source: Tensor,
    settings: SearchSettings,
    resolution: float,
    generator: torch.Generator,
) -> Hypotheses:
    """Refine, prune and merge hypotheses on the target's kernel fields.

    The first hypothesis is kept to the end: it is the caller's, or the identity.

    Args:
        hypotheses: at least one.
        target: (N, 3).
        source: (M, 3).
        settings: of the search.
        resolution: stretches every lengthscale for sparse clouds.
        generator: chooses the source points.

    Returns:
        at most ``settings.candidates`` hypotheses and the first one, best first after it.
    """
    first = hypotheses.select(torch.tensor([0]))
    z = source[torch.randperm(len(source), generator=generator)[: settings.source_points]]
    score = torch.zeros(len(hypotheses))
    for level in settings.levels:
        field = KernelField.of(target, level.lengthscale * resolution)
        T = hypotheses.T_target_source
        for _ in range(level.steps):
            T = field_step(field, z, T)
        score = field_score(field, z, T)
        best = score.topk(min(level.keep, len(score))).indices
        hypotheses, score = hypotheses.moved_to(T).select(best), score[best]
    kept = distinct(
        hypotheses.T_target_source,
        score,
        settings.candidates,
        settings.merge_angle_deg,
        settings.merge_distance * resolution,
    )
    rest = hypotheses.select(kept)
    return Hypotheses(
        torch.cat([first.T_target_source, rest.T_target_source]), torch.cat([first.kind, rest.kind])
    )
