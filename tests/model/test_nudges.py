"""Solved poses of sparse clouds slide on where the judge clearly gains, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from model import Registrar
from model.artifact import load_artifact
from model.deadline import always
from model.last_stage import LastStage, last_stage
from model.nudges import nudged
from model.options import Options
from model.pair import GivenPair
from model.pose_search import PoseSearch
from model.search import Holding
from training.data.motion import Motion
from training.data.pairs import pair_of_shape
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes
from training.data.seeding import Stream, torch_generator

SPARSE = Perturbation(
    sigma=(0.01, 0.01),
    outlier_share=(0.2, 0.2),
    crop_share=(0.2, 0.3),
    target_points=(180, 320),
    source_points=(180, 320),
)


@pytest.fixture(scope="module")
def registrars() -> tuple[Registrar, Registrar]:
    """With nudges, and without."""
    artifact = load_artifact()
    still = replace(artifact, settings=replace(artifact.settings, nudges=0))
    return Registrar(artifact), Registrar(still)


def sparse_pair(number: int) -> tuple[np.ndarray, np.ndarray]:
    shape = ProceduralShapes(64, 2048, 11)[number]
    pair = pair_of_shape(shape, SPARSE, torch_generator(number, Stream.PAIR))
    moved = pair.moved(Motion("haar", 180.0, 0.5).draw(torch_generator(number, Stream.MOTION)))
    return moved.source.double().numpy(), moved.target.double().numpy()


def searched(registrar: Registrar, number: int) -> tuple[PoseSearch, LastStage, np.ndarray]:
    """The search of a pair, its last stage and its answer in the frame."""
    options = Options.checked(None, 180.0, 0, "surface")
    pair = registrar._encode(GivenPair.checked(*sparse_pair(number), None, None), options)
    search = registrar._hypothesise(pair, options)
    settings, correct = registrar.artifact.settings, registrar._correct_pair
    stage = last_stage(settings, "surface", registrar._kernel, correct)
    return search, stage, registrar._solve(search, search.run()).T_target_source


def test_a_pose_beside_the_answer_is_led_on_where_the_judge_gains(registrars):
    """A pose that slid along what holds it least, and is said to be solved."""
    gains, nearer = [], []
    for number in range(8):
        search, stage, T = searched(registrars[1], number)
        x, z, spacing = search.pair.target.sparse, search.pair.source.sparse, search.pair.spacing
        slid = Holding.of(T, x, z, spacing).moved(0, 0.75 * spacing) @ T
        solved = stage.solve(search.pair.target, search.pair.source, slid, always)
        np.testing.assert_allclose(solved.T_target_source, slid, atol=1e-9)
        found = nudged(search, stage, solved, 3).T_target_source
        before, after = search.log_odds_at(np.stack([slid, found]))
        gains.append(after - before)
        nearer.append(np.linalg.norm(found - T) < np.linalg.norm(slid - T))
        np.testing.assert_array_equal(nudged(search, stage, solved, 0).T_target_source, slid)
    assert all(gain == 0.0 or gain >= 1.0 for gain in gains)
    assert np.mean(np.array(gains) > 0.0) > 0.5
    assert np.mean(nearer) > 0.5


def test_the_answer_stays_within_the_allowed_rotation(registrars):
    for number in range(4):
        source, target = sparse_pair(number)
        found = registrars[0].register(source, target, max_rotation_deg=5.0)
        R = torch.from_numpy(found.T_target_source[:3, :3])
        angle = torch.rad2deg(torch.arccos(((R.trace() - 1.0) / 2.0).clamp(-1.0, 1.0)))
        assert float(angle) <= 6.0 + 1e-6


def test_clouds_of_many_points_and_local_searches_are_left_alone(registrars, cloud):
    x, z = (cloud(0, 800, part).double().numpy() for part in range(2))
    source, target = sparse_pair(0)
    dense = [registrar.register(x, z).T_target_source for registrar in registrars]
    local = [
        registrar.register(source, target, initial=np.eye(4), search="local").T_target_source
        for registrar in registrars
    ]
    np.testing.assert_array_equal(*dense)
    np.testing.assert_array_equal(*local)


def test_without_a_judge_that_learned_the_pose_stays(registrars):
    source, target = sparse_pair(1)
    answers = [
        Registrar(replace(registrar.artifact, verifier=None)).register(source, target)
        for registrar in registrars
    ]
    np.testing.assert_array_equal(*(answer.T_target_source for answer in answers))


def test_clouds_that_share_their_points_are_held_by_them(registrars, pose):
    x = sparse_pair(2)[1]
    T = pose(3, 70.0).numpy()
    moved = x @ T[:3, :3].T + T[:3, 3]
    for points in (x, x[:30]):
        found = registrars[0].register(points, moved[: len(points)])
        np.testing.assert_allclose(found.T_target_source, T, atol=1e-4)
