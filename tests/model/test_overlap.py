"""Clouds cut to what they share: no pull beyond their ends, and poses that slide along a rail."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from model.search import Hypotheses, Start, slid_poses, varied_start
from model.search.consensus import MatchedPoints
from model.surface import SurfaceCloud, SurfaceLoop, overlapping

REACH = 0.12


def never() -> bool:
    return False


def rail(low: float, high: float, seed: int, points: int = 500, noise: float = 0.003) -> np.ndarray:
    """An angle rail along x, from ``low`` to ``high``: two boards at a right angle."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(low, high, points)
    across, off = rng.uniform(0.0, 0.5, points), noise * rng.normal(size=points)
    upright = rng.random(points) < 0.5
    return np.stack([x, np.where(upright, off, across), np.where(upright, across, off)], axis=1)


def shifted(*by: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = by
    return T


@pytest.fixture(scope="module")
def crops() -> tuple[SurfaceCloud, SurfaceCloud]:
    return SurfaceCloud.of(rail(-0.6, 0.3, 0)), SurfaceCloud.of(rail(-0.3, 0.6, 1))


def rows(part: SurfaceCloud, whole: SurfaceCloud) -> np.ndarray:
    distance, index = KDTree(whole.arrays.points).query(part.arrays.points)
    assert (distance == 0.0).all()
    return index


def test_what_is_left_are_the_points_that_have_one_of_the_other_cloud_near(crops):
    target, source = crops
    T = shifted(0.05, 0.01, 0.0)
    moved = source.arrays.points + T[:3, 3]
    x, z = overlapping(target, source, T, REACH)
    near = KDTree(moved).query(target.arrays.points)[0] < REACH
    np.testing.assert_array_equal(rows(x, target), np.flatnonzero(near))
    near = KDTree(target.arrays.points).query(moved)[0] < REACH
    np.testing.assert_array_equal(rows(z, source), np.flatnonzero(near))
    assert len(x.arrays.points) < 0.9 * len(target.arrays.points)
    assert x.spacing == target.spacing


def test_swapping_the_clouds_cuts_the_same_points(crops):
    target, source = crops
    T = shifted(0.1, 0.0, 0.02)
    x, z = overlapping(target, source, T, REACH)
    z_other, x_other = overlapping(source, target, np.linalg.inv(T), REACH)
    np.testing.assert_array_equal(x.arrays.points, x_other.arrays.points)
    np.testing.assert_array_equal(z.arrays.points, z_other.arrays.points)


def test_clouds_that_hardly_meet_stay_whole(crops):
    target, source = crops
    x, z = overlapping(target, source, shifted(9.0, 0.0, 0.0), REACH)
    assert x is target
    assert z is source


def test_clouds_that_meet_everywhere_stay_what_they_are():
    cloud = SurfaceCloud.of(rail(-0.5, 0.5, 2))
    x, z = overlapping(cloud, cloud, np.eye(4), REACH)
    assert x is cloud
    assert z is cloud


def test_other_parts_of_a_rail_do_not_pull_each_other_along_it(crops):
    target, source = crops
    slid = {
        overlap: SurfaceLoop(overlap=overlap).solve(target, source, np.eye(4), never)
        for overlap in (0.0, 1.2)
    }
    along = {overlap: abs(found.T_target_source[0, 3]) for overlap, found in slid.items()}
    # Whole clouds, each of which lacks a third, slide over each other by most of what was cut off.
    assert along[0.0] > 0.15
    assert along[1.2] < 0.05
    off = slid[1.2].T_target_source - np.eye(4)
    assert np.abs(off[1:3, 3]).max() < 0.01


def test_a_good_pose_slides_along_the_rail_by_steps_of_the_spacing(crops):
    target, source = crops
    spacing = target.spacing
    poses = slid_poses(np.eye(4), target, source, spacing)
    x, z = overlapping(target, source, np.eye(4), 1.2 * spacing)
    points = np.concatenate([x.arrays.points, z.arrays.points])
    moves = points @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3] - points
    sizes = np.sqrt(np.square(moves).sum(-1).mean(-1)) / spacing
    steps = np.repeat([0.7, 1.4, 2.1, 3.0], 2)
    np.testing.assert_allclose(np.sort(sizes[:8]), steps, rtol=0.01)
    # A turn moves points near its axis less.
    assert (sizes[8:] < 3.01).all()
    along = np.abs(moves[:8, :, 0]).mean(1) / np.linalg.norm(moves[:8], axis=-1).mean(1)
    assert (along > 0.95).all()
    assert sorted(np.sign(moves[:8, :, 0].mean(1))) == [-1.0] * 4 + [1.0] * 4


def test_slides_turn_no_farther_than_allowed(crops):
    target, source = crops
    identity = Hypotheses.of_kind("identity", torch.eye(4)[None])
    start = Start(identity, MatchedPoints.none(), 1)
    T = shifted(0.02, 0.0, 0.0)[None]
    slides = partial(slid_poses, target=target, source=source, spacing=target.spacing)
    free = varied_start(start, "slide", slides, T, 180.0).hypotheses
    held = varied_start(start, "slide", slides, T, 0.5).hypotheses
    assert int(free.of("slide").sum()) == 16
    assert 8 <= int(held.of("slide").sum()) < 16


def test_the_cut_can_be_switched_off(crops):
    target, source = crops
    whole = SurfaceLoop(overlap=0.0, together=0)
    found = whole.solve(target, source, np.eye(4), never)
    again = dataclasses.replace(whole, overlap=100.0).solve(target, source, np.eye(4), never)
    np.testing.assert_allclose(found.T_target_source, again.T_target_source, atol=1e-9)
