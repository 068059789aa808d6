"""Shifts: the kernel's sum over all translations, and clouds that slid far along what they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame_pairs import FramePairMaker, list_frame_pairs
from benchmarks.pose_error import PoseError
from model import Registrar
from model.artifact import Artifact, load_artifact
from model.search import Holding, shifted_poses
from model.search.shifts import _correlated, _peaks, _spread
from model.sequence import read_sequence
from model.surface import SurfaceCloud


def corner(n: int, seed: int) -> np.ndarray:
    """A floor and two walls of other lengths, with a box on the floor."""
    rng = np.random.default_rng(seed)
    u, v = rng.random((2, n))
    kind = rng.choice(4, n, p=[0.4, 0.2, 0.2, 0.2])
    x = np.empty((n, 3))
    zero = np.zeros(n)
    x[kind == 0] = np.stack([2.0 * u, v, zero], 1)[kind == 0]
    x[kind == 1] = np.stack([2.0 * u, zero, 0.5 * v], 1)[kind == 1]
    x[kind == 2] = np.stack([zero, u, 0.5 * v], 1)[kind == 2]
    x[kind == 3] = np.stack([0.9 + 0.3 * u, zero + 0.4, 0.4 * v], 1)[kind == 3]
    return x


def board(n: int, seed: int) -> np.ndarray:
    x = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 3))
    x[:, 2] = 0.0
    return x


@pytest.fixture(scope="module")
def rooms() -> tuple[SurfaceCloud, SurfaceCloud]:
    """Other samples of one room; the target lacks its one end, the source its other."""
    x, z = corner(700, 0), corner(700, 1)
    return SurfaceCloud.of(x[x[:, 0] < 1.6]), SurfaceCloud.of(z[z[:, 0] > 0.4])


def test_the_correlation_is_the_sum_over_all_pairs_of_points():
    rng = np.random.default_rng(2)
    shape = np.array([24, 20, 18])
    x, y = rng.integers(1, 8, (30, 3)).astype(float), rng.integers(1, 8, (20, 3)).astype(float)
    n, m = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 30, 3)))
    m = m[:20]
    total = _correlated(_spread(x, n, shape), _spread(y, m, shape))
    for shift in ((0, 0, 0), (2, -1, 3), (-4, 5, 0)):
        apart = x[:, None] - y[None] - np.array(shift)
        # Points on the grid's corners give all to one cell: they meet there or not at all.
        meet = (apart == 0.0).all(-1)
        expected = float((meet * (n @ m.T) ** 2).sum())
        assert total[shift] == pytest.approx(expected, abs=1e-4)


def test_points_between_corners_are_shared_linearly():
    grid = _spread(np.array([[1.25, 2.0, 3.5]]), np.array([[0.0, 0.0, 1.0]]), np.array([4, 4, 6]))
    assert grid.sum() == pytest.approx(1.0)
    assert grid[2, 1, 2, 3] == pytest.approx(0.375)
    assert grid[2, 2, 2, 4] == pytest.approx(0.125)
    other = _spread(np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([4, 4, 6]))
    assert _correlated(grid, other)[0, 0, 0] == pytest.approx(0.375, abs=1e-5)


def test_the_highest_cell_comes_first_and_low_ones_are_left_out():
    total = np.zeros((8, 9, 10), np.float32)
    total[7, 1, 2], total[3, 3, 3], total[5, 5, 5] = 5.0, 4.0, 1.0
    np.testing.assert_array_equal(_peaks(total), [[7, 1, 2], [3, 3, 3]])


@pytest.mark.parametrize("slid", [(1.1, 0.0, 0.0), (-0.8, 0.3, 0.1)])
def test_clouds_that_slid_far_are_found_where_they_belong(rooms, slid):
    target, source = rooms
    T = np.eye(4)
    T[:3, 3] = slid
    poses = shifted_poses(T, target, source, target.spacing)
    np.testing.assert_array_equal(poses[:, :3, :3], np.tile(np.eye(3), (len(poses), 1, 1)))
    off = np.linalg.norm(poses[:, :3, 3], axis=1)
    assert off.min() < target.spacing
    assert np.linalg.norm(poses[:, :3, 3] - slid, axis=1).min() > target.spacing


def test_swapping_the_clouds_inverts_the_shift(rooms):
    target, source = rooms
    T = np.eye(4)
    T[0, 3] = 1.1
    there = shifted_poses(T, target, source, target.spacing)[0, :3, 3]
    back = shifted_poses(np.linalg.inv(T), source, target, target.spacing)[0, :3, 3]
    np.testing.assert_allclose(there, -back, atol=target.spacing)


def test_a_stray_point_far_away_makes_cells_larger_not_more(rooms):
    target, source = rooms
    far = SurfaceCloud.of(np.concatenate([target.arrays.points, [[900.0, 700.0, 800.0]]]))
    poses = shifted_poses(np.eye(4), far, source, target.spacing)
    assert np.isfinite(poses).all()


def test_a_board_is_held_weakly_and_a_box_is_not():
    sheets = SurfaceCloud.of(board(400, 0)), SurfaceCloud.of(board(400, 1))
    assert Holding.of(np.eye(4), *sheets, sheets[0].spacing).is_weak
    top = board(150, 2) + np.array([0.0, 0.0, 1.0])
    faces = [np.roll(side * top, k, axis=1) for k in range(3) for side in (-1.0, 1.0)]
    box = SurfaceCloud.of(np.concatenate(faces))
    assert not Holding.of(np.eye(4), box, box, box.spacing).is_weak


def test_frames_that_show_walls_are_not_left_where_they_slid(data_root):
    sequence = read_sequence(data_root / "rgbd" / "redkitchen_a")
    maker = FramePairMaker(sequence, 1024, 0, None)
    entries = list_frame_pairs(sequence, range(425, 495), [30], ["extra-10"], 10, 0)
    pairs = [maker.make(entry) for entry in entries]
    artifact = load_artifact()
    hypotheses = replace(artifact.settings.hypotheses, shifts=0)
    without = replace(artifact, settings=replace(artifact.settings, hypotheses=hypotheses))

    def right(kind: Artifact) -> int:
        registrar = Registrar(kind)
        found = [registrar.register(pair.source, pair.target).T_target_source for pair in pairs]
        off = [PoseError.of(T, pair) for T, pair in zip(found, pairs, strict=True)]
        return sum(error.translation_centroid < 0.1 for error in off)

    shifted, slid = right(artifact), right(without)
    assert shifted >= slid + 2
