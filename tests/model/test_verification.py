"""Evidence for poses, the verifier, and what the registrar does with them."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from model import Registrar
from model.artifact import load_artifact
from model.exceptions import CloudShapeError, InvalidOptionError, NonFiniteCloudError
from model.options import Options
from model.pair import GivenPair
from model.pose_search import PoseSearch
from model.surface import SurfaceCloud
from model.verification import NAMES, Evidence, SurfaceAgreement, Verifier, surface_share
from model.verification.contact import POINTS, TRAITS, contact
from model.verification.evidence import patches


@pytest.fixture(scope="module")
def registrar() -> Registrar:
    return Registrar.load()


def pair(cloud, pose, i, angle, n=500, part=1):
    target, source = cloud(i, n).double().numpy(), cloud(i, n, part).double().numpy()
    T = pose(i, angle).numpy()
    return (source - T[:3, 3]) @ T[:3, :3], target, T


def angle_deg(A: np.ndarray, B: np.ndarray) -> float:
    chord = np.linalg.norm(A[:3, :3] - B[:3, :3]) / (2 * np.sqrt(2))
    return float(np.degrees(2 * np.arcsin(min(1.0, chord))))


def evidence(cloud, pose) -> Evidence:
    """Of the right pose and of a wrong one, for two samples of a shape."""
    x, z = (SurfaceCloud.of(cloud(2, 500, part).double().numpy()) for part in (0, 1))
    T = np.stack([np.eye(4), pose(3, 120.0).numpy()])
    return Evidence.of(x, z, T, np.array([40.0, 5.0]), 100, closely=True)


def test_the_right_pose_has_the_better_evidence_and_no_number_is_off(cloud, pose):
    found = evidence(cloud, pose)
    assert found.values.shape == (2, len(NAMES))
    assert np.isfinite(found.values).all()
    shares = [name for name in NAMES if not name.startswith(("log", "height", "likeness"))]
    for name in shares:
        assert (found.values[:, NAMES.index(name)] >= 0.0).all()
        assert (found.values[:, NAMES.index(name)] <= 1.0).all()
    right, wrong = found.values
    for name in ("overlap_least", "surface_least", "surface_mean", "facing", "tightness"):
        assert right[NAMES.index(name)] > wrong[NAMES.index(name)]
    scores = SurfaceAgreement().log_odds(found)
    assert scores[0] > scores[1]


def test_a_crop_leaves_one_gap_and_a_wrong_pose_many(cloud):
    points = cloud(4, 700).double().numpy()
    beside = SurfaceCloud.of(points).neighbours(0.2, 6)
    x = SurfaceCloud.of(points).at(0.2).arrays.points
    cropped = x[:, 0] > np.quantile(x[:, 0], 0.3)
    strewn = np.random.default_rng(0).permutation(cropped)
    assert patches(cropped, beside) > 0.8 > 0.5 > patches(strewn, beside)
    assert patches(np.ones_like(cropped), beside) == 1.0


def test_a_verifier_survives_json_and_refuses_what_is_not_one():
    verifier = load_artifact().verifier
    assert verifier is not None
    again = Verifier.from_dict(json.loads(json.dumps(verifier.as_dict())))
    rng = np.random.default_rng(0)
    glance = Evidence(rng.normal(size=(5, len(NAMES))), np.zeros(5))
    contacts = rng.normal(size=(5, 2, POINTS, len(TRAITS))).astype(np.float32)
    close = replace(glance, contacts=contacts)
    for seen in (glance, close):
        np.testing.assert_array_equal(again.log_odds(seen), verifier.log_odds(seen))
    assert not np.allclose(verifier.log_odds(glance), verifier.log_odds(close))
    plain = verifier.as_dict()
    for change in (
        {"evidence": ["other"]},
        {"traits": ["other"]},
        {"mean": [1.0]},
        {"glance": {**plain["glance"], "hidden_bias": [0.0]}},
        {"points": {**plain["points"], "out_bias": [0.0]}},
        {"verdict": plain["glance"]},
        {"scale": [float("nan")] * len(NAMES)},
        {"calibration": None},
    ):
        with pytest.raises(InvalidOptionError, match="calibrate"):
            Verifier.from_dict({**plain, **change})


def test_traits_are_the_same_after_a_motion_and_swapping_the_clouds_swaps_the_sides(cloud, pose):
    target, source = (cloud(2, 400, part).double().numpy() for part in (0, 1))
    T = pose(5, 3.0).double().numpy()
    x, z = SurfaceCloud.of(target), SurfaceCloud.of(source)
    seen = contact(x, z, T)
    assert seen.shape == (2, POINTS, len(TRAITS))
    assert np.isfinite(seen).all()
    swapped = contact(z, x, np.linalg.inv(T))
    np.testing.assert_allclose(swapped, seen[::-1], atol=1e-4)


def test_points_off_the_other_cloud_are_far_and_beyond_its_edge():
    rng = np.random.default_rng(0)
    flat = np.concatenate([rng.uniform(0.0, 1.0, (600, 2)), np.zeros((600, 1))], 1)
    left, all_of_it = SurfaceCloud.of(flat[flat[:, 0] < 0.5]), SurfaceCloud.of(flat)
    seen = dict(zip(TRAITS, contact(left, all_of_it, np.eye(4))[0].T, strict=True))
    assert 0.35 < np.mean(seen["very_close"] > 0.99) < 0.65
    just_off = (seen["distance"] > 0.3) & (seen["distance"] < 0.9)
    assert np.median(seen["beyond_edge"][just_off]) > 0.2
    assert np.median(seen["other_edge"][just_off]) > 0.25


def test_probability_grows_with_the_odds_and_with_the_lead():
    verifier = load_artifact().verifier
    assert verifier is not None
    sure, unsure = verifier.probability(8.0, 6.0), verifier.probability(-8.0, -6.0)
    assert 0.0 <= unsure < 0.3 < 0.8 < sure <= 1.0
    assert verifier.probability(1.0, 100.0) == verifier.probability(1.0, Verifier.LEAD)


def test_easy_pairs_are_probably_right_and_unlike_clouds_are_not(registrar, cloud, pose):
    source, target, T = pair(cloud, pose, 1, 140.0)
    easy = registrar.register(source, target)
    assert angle_deg(easy.T_target_source, T) < 3.0
    assert easy.diagnostics.success_probability > 0.8
    other = registrar.register(cloud(7, 500).double().numpy(), target)
    assert other.diagnostics.success_probability < 0.6
    bare = Registrar(replace(registrar.artifact, verifier=None)).register(source, target)
    assert bare.diagnostics.success_probability is None
    assert angle_deg(bare.T_target_source, T) < 3.0


@pytest.mark.parametrize("kind", ["square", "cylinder", "sphere"])
def test_a_surface_that_slides_is_never_probably_right(registrar, pose, kind):
    def surface(n: int, seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        turn, height = rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(-1.0, 1.0, n)
        if kind == "square":
            return np.column_stack([rng.uniform(-1.0, 1.0, (n, 2)), np.zeros(n)])
        radius = 0.6 if kind == "cylinder" else np.sqrt(1.0 - height**2)
        return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])

    T = pose(3, 70.0).numpy()
    source = (surface(500, 0) - T[:3, 3]) @ T[:3, :3]
    d = registrar.register(source, surface(600, 1)).diagnostics
    assert d.degenerate_directions
    assert d.success_probability is not None
    assert d.success_probability <= 0.2
    assert any("undetermined" in warning for warning in d.warnings)
    assert np.isfinite(d.covariance).all()


@pytest.mark.parametrize("angle", [3.0, 40.0, 170.0])
def test_the_answer_is_never_judged_worse_than_the_guess(registrar, cloud, pose, angle):
    source, target, T = pair(cloud, pose, 3, 100.0)
    guess = pose(8, angle, shift=0.05).numpy() @ T
    for options in ({}, {"max_rotation_deg": 10.0}, {"search": "local"}):
        found = registrar.register(source, target, initial=guess, **options)
        found_at, given_at = judged(registrar, source, target, guess, found, options)
        assert found_at >= given_at - 0.02


def judged(registrar, source, target, guess, found, options) -> np.ndarray:
    """The judge's log-odds of the answer and of the guess, in the same search."""
    checked = Options.checked(
        guess,
        options.get("max_rotation_deg", 180.0),
        0,
        "surface",
        options.get("search", "global"),
    )
    encoded = registrar._encode(GivenPair.checked(source, target, None, None), checked)
    poses = np.stack([encoded.frame.pose_in(T) for T in (found.T_target_source, guess)])
    log_odds: np.ndarray = registrar._hypothesise(encoded, checked).log_odds_at(poses)
    return log_odds


def test_a_guess_that_is_right_is_kept_and_only_sharpened(registrar, cloud, pose):
    source, target, T = pair(cloud, pose, 2, 77.0, part=0)
    near = registrar.register(source, target, initial=T, search="local")
    assert angle_deg(near.T_target_source, T) < 1e-3
    assert near.diagnostics.won_by == "initial"


def test_a_prepared_target_gives_the_same_answer(registrar, cloud, pose):
    source, target, T = pair(cloud, pose, 1, 60.0)
    prepared = registrar.prepare(target)
    assert prepared.nbytes > target.nbytes
    for scale in (1.0, 0.9):
        plain = registrar.register(source * scale, target)
        ready = registrar.register(source * scale, prepared)
        assert angle_deg(ready.T_target_source, plain.T_target_source) < 0.5
    assert angle_deg(registrar.register(source, prepared).T_target_source, T) < 3.0
    # A source far larger than the target can't use the target's unit.
    large = np.concatenate([source, 5.0 * source])
    assert np.isfinite(registrar.register(large, prepared).T_target_source).all()


def test_many_pairs_are_registered_as_one_by_one(registrar, cloud, pose):
    pairs = [pair(cloud, pose, i, 50.0)[:2] for i in range(3)]
    together = registrar.register_many(pairs, threads=2, seed=5)
    for (source, target), found in zip(pairs, together, strict=True):
        alone = registrar.register(source, target, seed=5)
        np.testing.assert_array_equal(found.T_target_source, alone.T_target_source)


@pytest.mark.parametrize("solver", ["surface", "procrustes", "gradient"])
def test_the_deadline_is_kept_and_the_best_so_far_returned(registrar, cloud, pose, solver):
    source, target, _ = pair(cloud, pose, 0, 120.0)
    registrar.register(source, target, solver=solver)
    started = time.monotonic()
    late = registrar.register(source, target, solver=solver, deadline=0.01)
    assert time.monotonic() - started < 1.0
    assert late.diagnostics.deadline_reached
    assert not late.diagnostics.converged
    assert np.isfinite(late.T_target_source).all()


def test_a_cancelled_registration_stops(registrar, cloud, pose):
    source, target, _ = pair(cloud, pose, 0, 120.0)
    gone = threading.Event()
    gone.set()
    assert registrar.register(source, target, cancel=gone).diagnostics.deadline_reached


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"deadline": 0.0}, "deadline"),
        ({"deadline": float("inf")}, "deadline"),
        ({"search": "nowhere"}, "search"),
        ({"solver": "magic"}, "solver"),
    ],
)
def test_options_out_of_range_are_refused(registrar, cloud, options, field):
    x = cloud(0, 100).double().numpy()
    with pytest.raises(InvalidOptionError, match=field):
        registrar.register(x, x, **options)


def test_labels_hold_a_pose_that_geometry_lets_slide(registrar):
    rng = np.random.default_rng(0)
    wall = np.concatenate([rng.uniform(-1, 1, size=(900, 2)), np.zeros((900, 1))], 1)
    other = np.concatenate([rng.uniform(-1, 1, size=(900, 2)), np.zeros((900, 1))], 1)
    # Of one cloud the left end is missing, of the other the right.
    wall, other = wall[wall[:, 0] > -0.6], other[other[:, 0] < 0.6]

    def texture(points: np.ndarray) -> np.ndarray:
        bright = np.sin(7 * points[:, 0]) * np.sin(5 * points[:, 1] + 1.0) > 0.2
        return np.stack([bright, ~bright], 1).astype(float)

    guess = np.eye(4)
    guess[0, 3] = 0.06
    bare = registrar.register(other, wall, initial=guess, search="local", max_rotation_deg=5.0)
    held = registrar.register(
        other,
        wall,
        initial=guess,
        search="local",
        max_rotation_deg=5.0,
        source_labels=texture(other),
        target_labels=texture(wall),
    )
    slid, stayed = (np.linalg.norm(r.T_target_source[:3, 3]) for r in (bare, held))
    assert stayed < 0.05
    assert slid > 0.2


def test_labels_that_do_not_fit_are_refused(registrar, cloud):
    x = cloud(0, 100).double().numpy()
    ones = np.ones((100, 2))
    for options, error in (
        ({"source_labels": ones}, CloudShapeError),
        ({"source_labels": ones, "target_labels": ones[:, :1]}, CloudShapeError),
        ({"source_labels": ones[:9], "target_labels": ones}, CloudShapeError),
        ({"source_labels": ones, "target_labels": ones * np.nan}, NonFiniteCloudError),
    ):
        with pytest.raises(error, match="labels"):
            registrar.register(x, x, **options)


def test_a_million_points_are_reduced_and_the_answer_says_so(registrar, cloud, pose):
    dense = cloud(3, 2048).double().numpy()
    rng = np.random.default_rng(1)
    many = np.repeat(dense, 20, axis=0) + 0.002 * rng.normal(size=(2048 * 20, 3))
    T = pose(1, 150.0).numpy()
    found = registrar.register((many - T[:3, 3]) @ T[:3, :3], many[::2])
    assert angle_deg(found.T_target_source, T) < 0.5
    assert found.diagnostics.points_source <= 20_000
    assert any("voxels" in note for note in found.diagnostics.warnings)


def test_all_points_tell_a_pose_from_a_slightly_slid_one(cloud, pose):
    x, z = (cloud(2, 900, part).double().numpy() for part in range(2))
    T = pose(1, 70.0).numpy()
    target, source = SurfaceCloud.of(x), SurfaceCloud.of((z - T[:3, 3]) @ T[:3, :3])
    right = surface_share(target, source, T)
    assert 0.3 < right <= 1.0
    for seed in range(5):
        wrong = pose(seed, 3.0, shift=0.05).numpy() @ T
        assert surface_share(target, source, wrong) < right
    swapped = surface_share(source, target, np.linalg.inv(T))
    assert swapped == pytest.approx(right)
    assert surface_share(target, source, pose(0, 0.0, shift=9.0).numpy() @ T) == 0.0


@pytest.mark.parametrize(
    ("points", "ahead", "chosen"), [(900, 1.0, 1), (900, 4.0, 0), (450, 1.0, 0)]
)
def test_all_points_decide_where_the_judge_saw_few_and_is_undecided(
    registrar, cloud, pose, monkeypatch, points, ahead, chosen
):
    source, target, T = pair(cloud, pose, 2, 70.0, n=points)
    options = Options.checked(None, 180.0, 0, "surface", "global")
    made = registrar._encode(GivenPair.checked(source, target, None, None), options)
    search = registrar._hypothesise(made, options)
    right = made.frame.pose_in(T)
    poses = np.stack([pose(3, 4.0, shift=0.05).numpy() @ right, right])
    monkeypatch.setattr(PoseSearch, "log_odds_at", lambda self, T: np.array([ahead, 0.0]))
    assert search.best_of(poses) == chosen
