"""Where the search starts: the guess, no motion, poses that features name, and in doubt others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.cloud_function import CloudFunction
from model.se3 import rotation_angle
from model.search.consensus import (
    Consensus,
    ConsensusSettings,
    MatchedPoints,
    consensus,
    fitted,
)
from model.search.grid_poses import GridLevel, slid_grid
from model.search.hypotheses import Hypotheses, within
from model.search.matching import matched_points, matched_poses
from model.search.voting import voted_poses
from model.side_by_side import run_together

FloatArray = npt.NDArray[np.float64]

# Refinement may turn a pose a little past the allowed rotation without being another answer.
ROTATION_SLACK_DEG = 1.0


def _grid_levels() -> list[GridLevel]:
    return [GridLevel(0.25, 3), GridLevel(0.12, 3)]


@dataclass(frozen=True, slots=True)
class HypothesisSettings:
    """Which start poses there are; each source can be switched off.

    Attributes:
        identity: whether no motion at all is a start pose.
        consensus: poses of three matches each that others agree with; see ConsensusSettings.
        triplets: whether there are any of those.
        matches: poses from one match each that are put to the vote; 0 for none.
        voted: most of those that are kept.
        more_matches: the same where the others leave a doubt; 0, or no matches, for none.
        more_voted: most of those that are kept.
        flips: how many of the best candidates are turned about the object's axes; see flips.py.
        shifts: how many of them are shifted to where the most surface meets; see shifts.py.
        slides: how many of them slide along what resists them least; see slides.py.
        grid_step_deg: spacing of the SO(3) grid; 0 for no grid.
        grid_levels: how the grid's poses slide into the basins of wide kernels.
        grid_kept: most of the grid's poses that are kept.
    """

    identity: bool = True
    triplets: bool = True
    consensus: ConsensusSettings = field(default_factory=ConsensusSettings)
    matches: int = 150
    voted: int = 6
    more_matches: int = 800
    more_voted: int = 40
    flips: int = 2
    shifts: int = 2
    slides: int = 2
    grid_step_deg: float = 30.0
    grid_levels: Sequence[GridLevel] = field(default_factory=_grid_levels)
    grid_kept: int = 8

    @property
    def compares_features(self) -> bool:
        """Whether any source of start poses looks at the features."""
        return self.triplets or self.matches > 0


@dataclass(frozen=True, slots=True)
class Start:
    """Start poses, what speaks for them, and how many were looked at.

    Attributes:
        hypotheses: K poses; the caller's guess, or else the identity, comes first.
        matches: pairs of points whose features look alike.
        tried: poses that were looked at to find these.
    """

    hypotheses: Hypotheses
    matches: MatchedPoints
    tried: int

    def allows(self, T: FloatArray, max_rotation_deg: float) -> bool:
        """Whether T (4, 4) turns no farther from the guess, or from no motion, than that."""
        R = torch.from_numpy(T[None, :3, :3]).float()
        angle = rotation_angle(R, self.hypotheses.T_target_source[:1, :3, :3])
        return bool(angle.rad2deg() <= max_rotation_deg + ROTATION_SLACK_DEG)

    def with_others(self, others: Hypotheses, tried: int, max_rotation_deg: float) -> Start:
        """The first pose, and instead of the rest those of others that turn no farther from it."""
        first = self.hypotheses.select(torch.tensor([0]))
        poses = Hypotheses.joined([first, others])
        allowed = within(poses, first.T_target_source[0, :3, :3], max_rotation_deg)
        return Start(poses.select(allowed), self.matches, self.tried + tried)


def hypothesise(
    target: CloudFunction,
    source: CloudFunction,
    groups: int,
    spacing: float,
    T_initial: Tensor | None,
    max_rotation_deg: float,
    settings: HypothesisSettings,
    seed: int,
) -> Start:
    """Collect the start poses that need no others.

    Args:
        target: (1, N, …) in the normalised frame.
        source: (1, M, …) in the normalised frame.
        groups: of channels, which are matched each by itself.
        spacing: of the clouds.
        T_initial: (4, 4) in the normalised frame, or None.
        max_rotation_deg: how far from the guess's rotation, or from none, a hypothesis may turn.
        settings: which sources there are.
        seed: of random draws.
    """
    given = given_start(T_initial, max_rotation_deg, settings)

    def agreed() -> tuple[MatchedPoints, Consensus]:
        matches = matched_points(target, source, groups if settings.compares_features else 0)
        if not settings.triplets:
            return matches, Consensus.empty()
        return matches, consensus(matches, spacing, settings.consensus, seed)

    of_triplets, of_single = run_together(
        agreed, lambda: _voted(target, source, spacing, settings.matches, settings.voted)
    )
    matches, agreement = of_triplets
    poses, singles = of_single
    parts = [
        given.hypotheses,
        _of_kind("consensus", agreement.T_target_source),
        _of_kind("matched", fitted(poses, matches, spacing, settings.consensus)),
    ]
    tried = given.tried + agreement.tried + singles
    return Start(_allowed(Hypotheses.joined(parts), max_rotation_deg), matches, tried)


def given_start(
    T_initial: Tensor | None, max_rotation_deg: float, settings: HypothesisSettings
) -> Start:
    """The start poses that need no features: the caller's guess, and no motion.

    Args:
        T_initial: (4, 4) in the normalised frame, or None.
        max_rotation_deg: how far from the guess no motion may turn.
        settings: whether no motion joins a guess; without a guess it is all there is.
    """
    parts: list[Hypotheses] = []
    if T_initial is not None:
        parts.append(Hypotheses.of_kind("initial", T_initial.float()[None]))
    if settings.identity or T_initial is None:
        parts.append(Hypotheses.of_kind("identity", torch.eye(4)[None]))
    hypotheses = _allowed(Hypotheses.joined(parts), max_rotation_deg)
    return Start(hypotheses, MatchedPoints.none(), len(parts))


def matched_start(
    start: Start,
    target: CloudFunction,
    source: CloudFunction,
    spacing: float,
    max_rotation_deg: float,
    settings: HypothesisSettings,
) -> Start:
    """Poses of many more single matches, for where few of them were right.

    Args:
        start: the other start poses.
        target: (1, N, …).
        source: (1, M, …).
        spacing: of the clouds.
        max_rotation_deg: from the first of the start poses.
        settings: how many.
    """
    poses, tried = _voted(target, source, spacing, settings.more_matches, settings.more_voted)
    matched = _of_kind("matched", fitted(poses, start.matches, spacing, settings.consensus))
    return start.with_others(matched, tried, max_rotation_deg)


def varied_start(
    start: Start,
    kind: str,
    vary: Callable[[FloatArray], FloatArray],
    T: FloatArray,
    max_rotation_deg: float,
) -> Start:
    """What good poses become when they are turned about the object's axes, or slide along it.

    Args:
        start: the other start poses.
        kind: ``flip``, ``shift`` or ``slide``.
        vary: (4, 4) → (P, 4, 4).
        T: (K, 4, 4) good poses.
        max_rotation_deg: from the first of the start poses.
    """
    varied = np.concatenate([vary(pose) for pose in T])
    return start.with_others(_of_kind(kind, varied), len(varied), max_rotation_deg)


def grid_start(
    start: Start,
    target: CloudFunction,
    source: CloudFunction,
    spacing: float,
    max_rotation_deg: float,
    settings: HypothesisSettings,
) -> Start:
    """The grid's poses, for where the others leave a doubt; its arguments are as above.

    Args:
        start: the other start poses; the grid lies about their first.
        target: (1, N, …).
        source: (1, M, …).
        spacing: of the clouds.
        max_rotation_deg: radius of the grid.
        settings: of the grid.
    """
    first = start.hypotheses.select(torch.tensor([0]))
    grid, seen = slid_grid(
        target.points[0],
        source.points[0],
        first.T_target_source[0, :3, :3],
        settings.grid_step_deg,
        max_rotation_deg,
        settings.grid_levels,
        settings.grid_kept,
        spacing,
    )
    return start.with_others(Hypotheses.of_kind("grid", grid), seen, max_rotation_deg)


def _voted(
    target: CloudFunction, source: CloudFunction, spacing: float, matches: int, kept: int
) -> tuple[FloatArray, int]:
    """The poses of single matches that most others stand near, and how many there were."""
    if not matches:
        return np.zeros((0, 4, 4)), 0
    single = matched_poses(target, source, matches)
    best = voted_poses(single, kept, spacing) if len(single) else single
    return best.double().numpy(), len(single)


def _allowed(hypotheses: Hypotheses, max_rotation_deg: float) -> Hypotheses:
    """The first, and those that turn no farther from it."""
    centre = hypotheses.T_target_source[0, :3, :3]
    allowed = within(hypotheses, centre, max_rotation_deg)
    allowed[0] = True
    return hypotheses.select(allowed)


def _of_kind(kind: str, T: FloatArray) -> Hypotheses:
    return Hypotheses.of_kind(kind, torch.from_numpy(T).float())
