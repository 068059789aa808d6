"""The self-check: scoring that cannot tell these apart has no teeth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import self_check
from benchmarks.command_line import benchmark_command
from benchmarks.competitor import CandidateOracle, Contestant, Truth
from benchmarks.methods import Answer, build_methods
from benchmarks.pair import BenchmarkPair, FloatArray
from benchmarks.pose_error import ADDS_SUCCESS, PoseError
from benchmarks.self_check import faults_of


def test_the_truth_scores_nothing(pairs: list[BenchmarkPair]) -> None:
    for pair in pairs:
        error = PoseError.of(Truth().answer(pair).answer.T_target_source, pair)
        assert error.rotation_deg == 0.0
        assert error.translation == error.translation_centroid == 0.0
        assert error.se3_log < 1e-12
        assert error.adds == pytest.approx(0.0, abs=1e-12)


def test_the_identity_scores_the_initial_angle(pairs: list[BenchmarkPair]) -> None:
    [identity] = build_methods(["identity"]).methods
    for pair in pairs:
        answer = Contestant(identity).answer(pair).answer
        error = PoseError.of(answer.T_target_source, pair)
        assert error.rotation_deg == pytest.approx(45.0, abs=1e-4)
        assert error.se3_log == pytest.approx(np.radians(45.0), abs=1e-6)
        assert error.adds is not None
        assert error.adds > ADDS_SUCCESS


def test_the_inverse_is_caught(pairs: list[BenchmarkPair]) -> None:
    for pair in pairs:
        error = PoseError.of(Truth(inverted=True).answer(pair).answer.T_target_source, pair)
        assert error.rotation_deg == pytest.approx(90.0, abs=1e-4)
        assert error.adds is not None
        assert error.adds > ADDS_SUCCESS


def test_translation_is_told_apart_from_rotation(pairs: list[BenchmarkPair]) -> None:
    pair = pairs[0]
    T = pair.T_target_source.copy()
    T[:3, 3] += [0.0, 0.3, 0.4]
    error = PoseError.of(T, pair)
    assert error.rotation_deg == 0.0
    assert error.translation == pytest.approx(0.5)
    assert error.translation_centroid == pytest.approx(0.5)


class Vandal:
    """Spoils what it is given."""

    name = "vandal"

    @property
    def settings(self) -> dict[str, Any]:
        return {}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        source[:] = target[:] = 0.0
        return Answer(np.eye(4))


def test_methods_get_copies(pairs: list[BenchmarkPair]) -> None:
    before = pairs[0].digest
    Contestant(Vandal()).answer(pairs[0])
    assert pairs[0].digest == before


class Undecided:
    """Answers with no motion and has the truth among its candidates."""

    name = "undecided"

    def __init__(self, T_target_source: FloatArray) -> None:
        self.T_target_source = T_target_source
        self.calls = 0

    @property
    def settings(self) -> dict[str, Any]:
        return {"weights": 1}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        self.calls += 1
        return Answer(np.eye(4), candidates=[-np.eye(4), self.T_target_source])


def test_the_oracle_picks_the_best_candidate_without_another_run(
    pairs: list[BenchmarkPair],
) -> None:
    method = Undecided(pairs[0].T_target_source)
    contestant = Contestant(method)
    oracle = CandidateOracle(contestant)
    assert contestant.answer(pairs[0]).answer.T_target_source[0, 0] == 1.0
    best = oracle.answer(pairs[0])
    assert np.array_equal(best.answer.T_target_source, pairs[0].T_target_source)
    assert best.seconds is None
    assert method.calls == 1
    oracle.answer(pairs[1])
    assert method.calls == 2
    assert oracle.name == "undecided_oracle"
    assert "knows the true pose" in oracle.settings["reference"]


def test_the_oracle_is_never_worse_than_our_answer(pairs: list[BenchmarkPair]) -> None:
    [ours] = build_methods(["ours"]).methods
    contestant = Contestant(ours)
    for pair in pairs[:2]:
        error = PoseError.of(contestant.answer(pair).answer.T_target_source, pair)
        best = PoseError.of(CandidateOracle(contestant).answer(pair).answer.T_target_source, pair)
        assert best.rank <= error.rank


def test_the_self_check_finds_no_fault_in_the_scoring(pairs: list[BenchmarkPair]) -> None:
    assert [fault for pair in pairs for fault in faults_of(pair)] == []


def test_the_self_check_finds_a_scoring_that_is_wrong(
    pairs: list[BenchmarkPair], monkeypatch: pytest.MonkeyPatch
) -> None:
    def blind(T_found: FloatArray, pair: BenchmarkPair) -> PoseError:
        return PoseError(0.0, 0.0, 0.0, 0.0, 0.0)

    def upside_down(T_found: FloatArray, pair: BenchmarkPair) -> PoseError:
        inverted = Truth(inverted=True).answer(pair).answer.T_target_source
        return right(T_found, replace(pair, T_target_source=inverted))

    def lenient(T_found: FloatArray, pair: BenchmarkPair) -> PoseError:
        return replace(right(T_found, pair), adds=0.0)

    right = PoseError.of
    for wrong, said in (
        (blind, ["initial angle", "applied twice"]),
        (lenient, ["the inverse passes for a success"]),
        (upside_down, ["the truth has no rotation error", "applied twice"]),
    ):
        monkeypatch.setattr(self_check.PoseError, "of", wrong)
        faults = " ".join(faults_of(pairs[0]))
        for claim in said:
            assert claim in faults


def test_the_check_is_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    assert benchmark_command(["check", "--limit", "1"]) == 0
    monkeypatch.setattr(self_check, "faults_of", lambda pair: ["a fault"])
    assert benchmark_command(["check", "--limit", "1"]) == 1
