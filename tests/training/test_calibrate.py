"""Fitting a verifier: that it learns which pose is right, and that its probabilities mean it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model import Registrar
from model.artifact import SHIPPED, load_artifact
from model.exceptions import InvalidOptionError
from model.verification import NAMES, Evidence, Verifier
from model.verification.contact import TRAITS
from training.data.procedural import ProceduralShapes
from training.verification.collection import JudgedPoses, adds, judged, usual_perturbation
from training.verification.command import calibrate_command
from training.verification.fit import calibration, fit_network


def made_up(pairs: int, seed: int) -> list[JudgedPoses]:
    """Evidence whose first entry tells right from wrong, the others nothing."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(pairs):
        right = rng.permutation([True, False, False, False])
        values = rng.normal(size=(4, len(NAMES)))
        values[:, 0] += 1.5 * right
        contacts = rng.normal(size=(4, 2, 16, len(TRAITS))).astype(np.float32)
        # The points know better than the evidence does.
        contacts[..., 0] += 1.5 * right[:, None, None]
        best = int(values[:, 0].argmax())
        rest = np.delete(values[:, 0], best)
        evidence = Evidence(values, np.zeros(4), contacts)
        found.append(
            JudgedPoses(
                evidence,
                right,
                evidence.select(np.array([best])),
                bool(right[best]),
                float(values[best, 0] - rest.max()),
                float(values[best, 0]),
            )
        )
    return found


def chosen_right(verifier: Verifier, pairs: list[JudgedPoses], closely: bool) -> float:
    right = []
    for pair in pairs:
        seen = pair.candidates if closely else replace(pair.candidates, contacts=None)
        right.append(pair.candidates_right[verifier.log_odds(seen).argmax()])
    return float(np.mean(right))


def test_the_network_learns_which_pose_is_right_and_is_the_same_every_time(monkeypatch):
    monkeypatch.setattr("training.verification.fit._STEPS", 300)
    verifier = fit_network(made_up(300, 0), seed=0)
    fresh = made_up(300, 1)
    best = np.mean([p.candidates_right[p.candidates.values[:, 0].argmax()] for p in fresh])
    assert chosen_right(verifier, fresh, closely=False) > best - 0.05
    assert chosen_right(verifier, fresh, closely=True) > max(best + 0.1, 0.95)
    again = fit_network(made_up(300, 0), seed=0)
    np.testing.assert_array_equal(again.points.hidden_weight, verifier.points.hidden_weight)


def test_probabilities_are_calibrated(monkeypatch):
    monkeypatch.setattr("training.verification.fit._STEPS", 100)
    judged_pairs = made_up(2000, 2)
    verifier = fit_network(judged_pairs[:300], seed=0)
    c = calibration(judged_pairs[300:1200])
    held_out = judged_pairs[1200:]
    x = np.array([[1.0, p.log_odds, np.clip(p.lead, -6.0, 6.0)] for p in held_out])
    probability = 1.0 / (1.0 + np.exp(-x @ c))
    right = np.array([pair.solved_right for pair in held_out])
    assert abs(probability.mean() - right.mean()) < 0.03
    low, high = probability < 0.7, probability > 0.95
    assert abs(probability[high].mean() - right[high].mean()) < 0.05
    assert right[low].mean() < right[high].mean()
    assert np.isfinite(verifier.mean).all()


def test_nothing_is_fitted_to_poses_of_one_kind():
    with pytest.raises(InvalidOptionError, match="pairs"):
        fit_network(made_up(2, 0), seed=0)


def test_a_pair_is_judged_by_the_pose_that_was_made_for_it():
    shapes = ProceduralShapes(16, 2048, 3)
    perturbation = usual_perturbation(2048)
    found = judged(Registrar.load(), shapes[2], perturbation, seed=11)
    assert found.candidates.values.shape == (len(found.candidates_right), len(NAMES))
    assert found.candidates.contacts is not None
    surface = shapes[2].points[:300].double().numpy()
    T = np.eye(4)
    T[:3, 3] = 0.3
    assert adds(surface, T, T) == 0.0
    assert adds(surface, np.eye(4), T) > 0.05


def test_the_command_writes_a_verifier_into_the_artifact(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("training.verification.fit._STEPS", 50)
    artifact = tmp_path / "artifact"
    shutil.copytree(SHIPPED / "default", artifact)
    before = load_artifact(artifact)
    assert calibrate_command([str(artifact), "--pairs", "16", "--held-out", "6"]) == 0
    after = load_artifact(artifact)
    assert after.weights_sha256 == before.weights_sha256
    assert after.verifier is not None
    assert not np.array_equal(after.verifier.mean, before.verifier.mean)
