"""A solved pose of sparse clouds, moved on where the judge clearly prefers a pose beside it.

Between few points there are several ways to come to rest, a fraction of a spacing apart along what
the surfaces resist least. The kernel's sum hardly tells them apart; how the clouds' ends meet does.
"""

from __future__ import annotations

from dataclasses import replace

from model.deadline import always
from model.last_stage import LastStage, Solved
from model.pair import Pair
from model.pose_search import PoseSearch
from model.search import FEWEST, NUDGES, slid_poses
from model.surface import Meeting

# Clouds of more points hold their poses.
_FEW = 700
# By so many log-odds a pose has to be better.
_CLEARLY = 1.0


def nudged(search: PoseSearch, stage: LastStage, solved: Solved, rounds: int) -> Solved:
    """Slide a solved pose a little and solve it again, as long as the judge clearly gains.

    Where solving leads back, the pose that slid stays as it is. Clouds that share their points are
    held by these, and a judge that hasn't learned how ends of clouds meet isn't asked.

    Args:
        search: of the pair.
        stage: that solved it.
        solved: the pose.
        rounds: at most this many slides; 0 leaves the pose alone.
    """
    pair, stop = search.pair, search.options.deadline.passed
    if search.options.search == "local" or not search.judge.CLOSELY:
        return solved
    if not _are_sparse_samples(pair, solved):
        return solved
    log_odds = float(search.log_odds_at(solved.T_target_source[None])[0])
    for _ in range(rounds):
        T = slid_poses(
            solved.T_target_source,
            pair.target.sparse,
            pair.source.sparse,
            pair.sparse_spacing,
            NUDGES,
        )
        T = T[[search.start.allows(pose, search.options.max_rotation_deg) for pose in T]]
        if stop() or not len(T):
            break
        beside = search.log_odds_at(T)
        best = int(beside.argmax())
        if beside[best] < log_odds + _CLEARLY:
            break
        again = stage.solve(pair.target, pair.source, T[best], stop)
        ahead = float(search.log_odds_at(again.T_target_source[None])[0])
        allowed = search.start.allows(again.T_target_source, search.options.max_rotation_deg)
        if ahead >= log_odds + _CLEARLY and allowed:
            solved, log_odds = again, ahead
        else:
            there = stage.solve(pair.target, pair.source, T[best], always)
            solved = replace(there, converged=again.converged)
            log_odds = float(beside[best])
    return solved


def _are_sparse_samples(pair: Pair, solved: Solved) -> bool:
    target, source = pair.target.dense, pair.source.dense
    fewer = min(len(target.arrays.points), len(source.arrays.points))
    if not FEWEST <= fewer < _FEW:
        return False
    meeting = Meeting.of(target, source, solved.T_target_source)
    return meeting is not None and meeting.apart
