from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from model import Registrar
from model.artifact import Artifact
from model.encoder import build_encoder
from model.exceptions import (
    CloudShapeError,
    DegenerateCloudError,
    InvalidOptionError,
    NonFiniteCloudError,
    TooFewPointsError,
)
from model.pose_search import PoseSearch
from model.se3 import rotation_angle
from model.settings import RegistrarSettings


@pytest.fixture(scope="module")
def registrar() -> Registrar:
    """The shipped artifact: what users get."""
    return Registrar.load()


def error_deg(T: np.ndarray, T_true: np.ndarray) -> float:
    angle = rotation_angle(torch.from_numpy(T[:3, :3]), torch.from_numpy(T_true[:3, :3]))
    return math.degrees(angle.item())


def pair(cloud, pose, i, angle, n=512, m=512, part=0):
    """Clouds (m, 3), (n, 3) and T_target_source; another part is another sample of the shape."""
    target, source = cloud(i, n).double().numpy(), cloud(i, m, part).double().numpy()
    T = pose(i, angle).numpy()
    return (source - T[:3, 3]) @ T[:3, :3], target, T


@pytest.mark.parametrize("i", range(4))
def test_any_rotation_is_recovered_exactly_from_the_same_points(registrar, cloud, pose, i):
    source, target, T = pair(cloud, pose, i, 45.0 * (i + 1))
    result = registrar.register(source, target)
    assert error_deg(result.T_target_source, T) < 0.05
    np.testing.assert_allclose(result.transform(source), target, atol=2e-3)
    d = result.diagnostics
    assert d.similarity > 0.99
    assert d.converged
    assert d.overlap_source > 0.99
    assert abs(d.rkhs_distance) < 0.01 * 512
    assert d.seconds["total"] >= sum(v for k, v in d.seconds.items() if k != "total") * 0.99


def test_another_sample_of_another_size_is_registered(registrar, cloud, pose):
    source, target, T = pair(cloud, pose, 1, 100.0, n=900, m=500, part=2)
    result = registrar.register(source, target)
    assert error_deg(result.T_target_source, T) < 2.0
    assert (result.diagnostics.points_target, result.diagnostics.points_source) == (900, 500)


def test_the_papers_gradient_loop_gives_the_same_diagnostics(registrar, cloud, pose):
    source, target, T = pair(cloud, pose, 2, 60.0, part=1)
    result = registrar.register(source, target, solver="gradient")
    assert error_deg(result.T_target_source, T) < 3.0
    assert result.diagnostics.solver == "gradient"
    assert len(result.diagnostics.trace) == result.diagnostics.iterations > 3
    lengthscales = [step.lengthscale for step in result.diagnostics.trace]
    assert lengthscales[0] != lengthscales[-1]


def test_swapping_the_clouds_gives_the_inverse(registrar, cloud, pose):
    source, target, _ = pair(cloud, pose, 3, 130.0, part=1)
    there = registrar.register(source, target).T_target_source
    back = registrar.register(target, source).T_target_source
    assert error_deg(there @ back, np.eye(4)) < 0.5
    assert np.linalg.norm((there @ back)[:3, 3]) < 0.01


def test_moving_a_cloud_moves_the_answer_with_it(registrar, cloud, pose):
    source, target, _ = pair(cloud, pose, 0, 50.0)
    T = registrar.register(source, target).T_target_source
    A = pose(9, 75.0, shift=3.0).numpy()
    moved = target @ A[:3, :3].T + A[:3, 3]
    after = registrar.register(source, moved).T_target_source
    assert error_deg(after, A @ T) < 0.05
    np.testing.assert_allclose(after[:3, 3], (A @ T)[:3, 3], atol=2e-3)


def test_units_and_far_origins_do_not_matter(registrar, cloud, pose):
    source, target, T = pair(cloud, pose, 1, 80.0)
    utm = np.array([500_000.0, 5_300_000.0, 400.0])
    scaled = registrar.register(source * 1000.0, target * 1000.0 + utm)
    expected = T.copy()
    expected[:3, 3] = 1000.0 * T[:3, 3] + utm
    assert error_deg(scaled.T_target_source, expected) < 0.05
    moved = scaled.transform(source * 1000.0)
    np.testing.assert_allclose(moved, target * 1000.0 + utm, atol=2.0)


def test_the_same_seed_gives_the_same_answer_and_another_a_close_one(registrar, cloud, pose):
    source, target, _ = pair(cloud, pose, 2, 160.0, part=1)
    first, again = (registrar.register(source, target, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.T_target_source, again.T_target_source)
    other = registrar.register(source, target, seed=4)
    assert error_deg(first.T_target_source, other.T_target_source) < 1.0


def test_shuffled_points_change_little(registrar, cloud, pose):
    source, target, _ = pair(cloud, pose, 2, 70.0)
    rng = np.random.default_rng(0)
    first = registrar.register(source, target).T_target_source
    second = registrar.register(rng.permutation(source), rng.permutation(target)).T_target_source
    assert error_deg(first, second) < 0.01


def test_an_initial_guess_and_a_limit_keep_the_answer_near(registrar, cloud, pose):
    source, target, T = pair(cloud, pose, 3, 170.0)
    guess = T @ pose(5, 10.0, shift=0.02).numpy()
    near = registrar.register(source, target, initial=guess, max_rotation_deg=20.0)
    assert error_deg(near.T_target_source, T) < 0.05
    limited = registrar.register(source, target, max_rotation_deg=30.0)
    assert error_deg(limited.T_target_source, np.eye(4)) <= 31.0


@pytest.mark.parametrize(("bonus", "away_deg"), [(0.5, 0.0), (5.0, 10.0)])
def test_a_guess_wins_where_the_judge_clearly_prefers_it(
    registrar, cloud, pose, monkeypatch, bonus, away_deg
):
    source, target, T = pair(cloud, pose, 3, 20.0)
    guess = T @ pose(5, 10.0, shift=0.02).numpy()

    def fond_of_the_guess(search: PoseSearch, poses: np.ndarray) -> np.ndarray:
        known = search.pair.initial(guess).numpy()
        return np.array([bonus if np.allclose(P, known) else 0.0 for P in poses])

    monkeypatch.setattr(PoseSearch, "log_odds_at", fond_of_the_guess)
    found = registrar.register(source, target, initial=guess, search="local").T_target_source
    assert error_deg(found, T) == pytest.approx(away_deg, abs=0.1)


def test_different_units_are_warned_about(registrar, cloud):
    x = cloud(0).double().numpy()
    result = registrar.register(x, 1000.0 * x)
    assert any("unit" in warning for warning in result.diagnostics.warnings)


def test_a_flat_cloud_is_registered_and_warned_about(registrar):
    rng = np.random.default_rng(1)
    flat = np.c_[rng.uniform(size=(400, 2)) * [1.0, 0.6], np.zeros(400)]
    flat = flat[flat[:, 0] + flat[:, 1] < 1.1]
    result = registrar.register(flat, flat)
    assert np.isfinite(result.T_target_source).all()
    assert np.linalg.det(result.rotation) == pytest.approx(1.0)
    assert any("flat" in warning for warning in result.diagnostics.warnings)


@pytest.mark.parametrize("n", [4, 5, 12])
def test_tiny_clouds_answer(registrar, n):
    x = np.random.default_rng(n).normal(size=(n, 3))
    result = registrar.register(x, x)
    assert np.isfinite(result.T_target_source).all()
    assert np.isfinite(result.diagnostics.similarity)


GOOD = np.random.default_rng(0).normal(size=(20, 3))
LINE = np.outer(np.arange(20.0), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("bad", "error", "said"),
    [
        ([], TooFewPointsError, "empty"),
        (np.zeros((0, 3)), TooFewPointsError, "empty"),
        (GOOD[:3], TooFewPointsError, "3 points"),
        (GOOD[:, :2], CloudShapeError, r"\(20, 2\)"),
        (GOOD.ravel(), CloudShapeError, r"\(60,\)"),
        ([[1, 2, 3], [1, 2]], CloudShapeError, "rows of three"),
        ([["a", "b", "c"]] * 5, CloudShapeError, "numbers"),
        ([[10**400, 0, 0]] * 5, CloudShapeError, "numbers"),
        (GOOD * 1j, CloudShapeError, "numbers"),
        (np.where(GOOD > 1.5, np.nan, GOOD), NonFiniteCloudError, "NaN"),
        (np.where(GOOD > 1.5, np.inf, GOOD), NonFiniteCloudError, "infinite"),
        (np.ones((20, 3)), DegenerateCloudError, "equal"),
        (np.ones((20, 3)) * 1e6 + 0.1, DegenerateCloudError, "equal"),
        (LINE, DegenerateCloudError, "line"),
        (LINE + 1e6, DegenerateCloudError, "line"),
        (None, CloudShapeError, "shape"),
    ],
)
@pytest.mark.parametrize("field", ["source", "target"])
def test_bad_clouds_are_refused_by_name(registrar, bad, error, said, field):
    clouds = {"source": GOOD, "target": GOOD, field: bad}
    with pytest.raises(error, match=f"{field}: .*{said}") as caught:
        registrar.register(**clouds)
    assert caught.value.field == field
    assert caught.value.mend


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("max_rotation_deg", 0.0),
        ("max_rotation_deg", 181.0),
        ("max_rotation_deg", float("nan")),
        ("max_rotation_deg", "wide"),
        ("seed", -1),
        ("seed", 1.5),
        ("seed", True),
        ("solver", "newton"),
        ("initial", np.eye(3)),
        ("initial", np.diag([2.0, 2.0, 2.0, 1.0])),
        ("initial", np.diag([1.0, 1.0, -1.0, 1.0])),
        ("initial", np.full((4, 4), np.nan)),
        ("initial", "identity"),
    ],
)
def test_bad_options_are_refused_by_name(registrar, option, value):
    with pytest.raises(InvalidOptionError, match=f"{option}: ") as caught:
        registrar.register(GOOD, GOOD, **{option: value})
    assert caught.value.field == option
    assert caught.value.mend


def test_the_papers_encoder_registers_too(cloud, pose):
    torch.manual_seed(0)
    encoder = build_encoder("vn_dgcnn")
    artifact = Artifact(
        "paper", "vn_dgcnn", {}, "tanh", RegistrarSettings(), {}, encoder.state_dict()
    )
    source, target, T = pair(cloud, pose, 1, 90.0, n=300, m=300)
    result = Registrar(artifact).register(source, target)
    assert error_deg(result.T_target_source, T) < 0.05
