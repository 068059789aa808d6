"""From many start poses to the few worth solving exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from model.search.field_steps import field_score, field_step
from model.search.hypotheses import Hypotheses, distinct
from model.search.kernel_field import KernelField
from model.search.voting import consensus, support


@dataclass(frozen=True, slots=True)
class SearchLevel:
    """Closed-form steps on the field of one lengthscale.

    Attributes:
        lengthscale: ℓ of the field, in the normalised frame.
        steps: how many.
    """

    lengthscale: float
    steps: int


def _grid_levels() -> list[SearchLevel]:
    return [SearchLevel(0.25, 3), SearchLevel(0.12, 3)]


def _levels() -> list[SearchLevel]:
    return [SearchLevel(0.08, 2), SearchLevel(0.05, 3)]


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How long to search.

    Attributes:
        source_points: source points that move and score a hypothesis.
        voted: candidates by the agreement of matched hypotheses.
        scored: candidates by the kernel field, from the grid.
        grid_levels: how the grid's poses slide into the basins of wide kernels.
        levels: how all candidates are refined, coarse to fine.
        merge_angle_deg: refined candidates closer than this are merged, if
        merge_distance: also their translations are this close.
    """

    source_points: int = 256
    voted: int = 24
    scored: int = 8
    grid_levels: Sequence[SearchLevel] = field(default_factory=_grid_levels)
    levels: Sequence[SearchLevel] = field(default_factory=_levels)
    merge_angle_deg: float = 4.0
    merge_distance: float = 0.08


@dataclass(frozen=True, slots=True)
class Candidates:
    """What the search leaves.

    Attributes:
        hypotheses: refined, the caller's own first and as it was.
        support: (K,) see ``voting.support``.
    """

    hypotheses: Hypotheses
    support: Tensor

    def select(self, index: Tensor) -> Candidates:
        """Keep those at ``index``, in its order, or where a mask is true."""
        return Candidates(self.hypotheses.select(index), self.support[index])


def coarse_to_fine(
    hypotheses: Hypotheses,
    target: Tensor,
    source: Tensor,
    settings: SearchSettings,
    resolution: float,
    generator: torch.Generator,
) -> Candidates:
    """Vote, score, refine and merge.

    Args:
        hypotheses: at least one; the first is kept to the end as it is.
        target: (N, 3).
        source: (M, 3).
        settings: of the search.
        resolution: stretches every lengthscale for sparse clouds.
        generator: chooses the source points.
    """
    z = source[torch.randperm(len(source), generator=generator)[: settings.source_points]]
    voters = hypotheses.select(hypotheses.of("matched"))
    others = hypotheses.select(hypotheses.of("initial", "identity"))
    grid = hypotheses.select(hypotheses.of("grid"))
    chosen = Hypotheses.joined(
        [
            others,
            _voted(voters, settings, resolution),
            _scored(grid, target, z, settings, resolution),
        ]
    )
    refined = _stepped(chosen, target, z, settings.levels, resolution)
    votes = support(refined.T_target_source, voters.T_target_source, resolution)
    kept = distinct(
        refined.T_target_source,
        votes,
        len(refined),
        settings.merge_angle_deg,
        settings.merge_distance * resolution,
    )
    first = hypotheses.select(torch.tensor([0]))
    own_votes = support(first.T_target_source, voters.T_target_source, resolution)
    return Candidates(
        Hypotheses.joined([first, refined.select(kept)]), torch.cat([own_votes, votes[kept]])
    )


def _voted(voters: Hypotheses, settings: SearchSettings, resolution: float) -> Hypotheses:
    """The poses that most matches agree on."""
    T = voters.T_target_source
    if len(T) == 0 or settings.voted == 0:
        return voters.select(torch.zeros(0, dtype=torch.long))
    votes = support(T, T, resolution)
    best = voters.select(distinct(T, votes, settings.voted, 15.0, 0.2 * resolution))
    return best.moved_to(consensus(best.T_target_source, T, resolution))


def _scored(
    grid: Hypotheses, target: Tensor, z: Tensor, settings: SearchSettings, resolution: float
) -> Hypotheses:
    """The grid's poses, slid into basins of wide kernels, that score best there."""
    if len(grid) == 0 or settings.scored == 0:
        return grid.select(torch.zeros(0, dtype=torch.long))
    few = z[: max(4, len(z) // 2)]
    slid = _stepped(grid, target, few, settings.grid_levels, resolution)
    last = KernelField.of(target, settings.grid_levels[-1].lengthscale * resolution)
    score = field_score(last, few, slid.T_target_source)
    best = distinct(slid.T_target_source, score, settings.scored, 10.0, 0.2 * resolution)
    return slid.select(best)


def _stepped(
    hypotheses: Hypotheses,
    target: Tensor,
    z: Tensor,
    levels: Sequence[SearchLevel],
    resolution: float,
) -> Hypotheses:
    T = hypotheses.T_target_source
    for level in levels:
        field = KernelField.of(target, level.lengthscale * resolution)
        for _ in range(level.steps):
            T = field_step(field, z, T)
    return hypotheses.moved_to(T)
