"""The self-check: scoring that cannot tell these apart has no teeth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.competitor import Contestant, Oracle
from benchmarks.methods import Answer, build_methods
from benchmarks.pair import BenchmarkPair, FloatArray
from benchmarks.pose_error import ADDS_SUCCESS, PoseError


def test_the_oracle_scores_nothing(pairs: list[BenchmarkPair]) -> None:
    for pair in pairs:
        error = PoseError.of(Oracle().answer(pair).answer.T_target_source, pair)
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
        error = PoseError.of(Oracle(inverted=True).answer(pair).answer.T_target_source, pair)
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
