from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from heap import motion

from model.exceptions import InvalidOptionError
from model.odometry import (
    AbsoluteError,
    ConstantVelocity,
    Cycle,
    RelativeError,
    VoxelMap,
)


def test_velocity_is_by_time_and_not_by_frame() -> None:
    one = motion(4.0, (0, 1, 0), (0.1, 0.0, 0.02))
    still = ConstantVelocity(0.0, np.eye(4))
    np.testing.assert_array_equal(still.predict(1.0), np.eye(4))
    moving = still.moved(0.1, one)
    twice = motion(8.0, (0, 1, 0), (0, 0, 0))
    np.testing.assert_allclose((moving.predict(0.2))[:3, :3], twice[:3, :3], atol=1e-12)
    half = moving.predict(0.15)
    np.testing.assert_allclose(
        (np.linalg.inv(one) @ half)[:3, :3], motion(2.0, (0, 1, 0), (0, 0, 0))[:3, :3], atol=1e-12
    )
    # After a long gap, or backwards, the last motion says nothing.
    np.testing.assert_array_equal(moving.predict(5.0), one)
    np.testing.assert_array_equal(moving.predict(0.05), one)


def test_a_loop_of_true_motions_is_closed() -> None:
    T_ab = motion(20.0, (1, 2, 3), (0.1, 0.2, 0.3))
    T_bc = motion(30.0, (3, -1, 0), (0.5, 0.0, -0.1))
    assert Cycle.of(T_ab, T_bc, T_ab @ T_bc).rotation_deg == pytest.approx(0.0, abs=1e-6)
    off = motion(3.0, (0, 0, 1), (0.04, 0.0, 0.03))
    cycle = Cycle.of(T_ab, T_bc @ off, T_ab @ T_bc)
    assert cycle.rotation_deg == pytest.approx(3.0)
    assert cycle.translation == pytest.approx(0.05)


def path(n: int) -> np.ndarray:
    return np.array(
        [motion(3.0 * k, (0.2, 1, 0), (0.1 * k, 0.02 * k * k, math.sin(k))) for k in range(n)]
    )


def test_errors_dont_depend_on_the_world() -> None:
    T = path(12)
    world = motion(50.0, (1, 1, 0), (5, 6, 7))
    absolute, relative = AbsoluteError.of(world @ T, T), RelativeError.of(world @ T, T, 2)
    assert absolute is not None
    assert relative is not None
    assert absolute.spread.largest < 1e-9
    assert relative.rotation_deg.largest < 1e-5
    assert relative.translation.largest < 1e-9
    np.testing.assert_allclose(absolute.T_truth_world @ world, np.eye(4), atol=1e-9)


def test_errors_are_those_that_were_made() -> None:
    T = path(12)
    off = motion(0.1, (0, 0, 1), (0.003, 0.004, 0.0))
    found = [T[0]]
    for before, after in itertools.pairwise(T):
        found.append(found[-1] @ np.linalg.inv(before) @ after @ off)
    relative = RelativeError.of(np.array(found), T, 1)
    assert relative is not None
    assert relative.rotation_deg.mean == pytest.approx(0.1)
    assert relative.rotation_deg.std == pytest.approx(0.0, abs=1e-6)
    assert relative.translation.mean == pytest.approx(0.005)
    assert len(relative.translations) == 11
    moved = T.copy()
    moved[3, :3, 3] += [0.0, 0.0, 0.2]
    absolute = AbsoluteError.of(moved, T)
    assert absolute is not None
    assert absolute.distances.argmax() == 3
    assert 0.1 < absolute.spread.largest < 0.2
    assert RelativeError.of(T, T, 12) is None
    assert AbsoluteError.of(T[:1], T[:1]) is None


def test_a_map_holds_the_means_of_its_voxels() -> None:
    voxels = VoxelMap(1.0)
    T = motion(0.0, (1, 0, 0), (0.0, 10.0, 0.0))
    voxels.add(np.array([[0.2, 0.2, 0.2], [0.4, 0.4, 0.4], [-0.5, 0.5, 0.5]]), T)
    points = voxels.points()
    assert {tuple(np.round(p, 6)) for p in points} == {(0.3, 10.3, 0.3), (-0.5, 10.5, 0.5)}


def test_a_map_forgets_what_one_frame_of_many_saw_and_keeps_colours() -> None:
    voxels = VoxelMap(0.5)
    wall = np.array([[0.1, 0.1, 2.0], [0.9, 0.1, 2.0]])
    for k in range(8):
        points = np.r_[wall, [[0.0, 0.0, 0.3 + 0.6 * k]]] if k != 2 else wall
        colours = np.tile(np.float32([0.5, 0.25, 1.0]), (len(points), 1))
        voxels.add(points, np.eye(4), colours)
    lone = np.abs(voxels.points()[:, 2] - 2.0) > 0.3
    assert not lone.any()
    np.testing.assert_allclose(voxels.colours(), np.tile([0.5, 0.25, 1.0], (2, 1)))


def test_a_map_that_grows_too_large_coarsens_and_loses_no_point() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-20.0, 20.0, (5000, 3))
    voxels = VoxelMap(0.1, most=600)
    voxels.add(points, np.eye(4))
    assert len(voxels) <= 600
    assert voxels.edge > 0.1
    state = voxels.state()
    again = VoxelMap.from_state(state)
    np.testing.assert_array_equal(again.points(), voxels.points())
    assert again.edge == voxels.edge
    counts = state["sums"][:, 0]
    assert counts.sum() == 5000
    np.testing.assert_allclose((counts[:, None] * voxels.points()).sum(0), points.sum(0), rtol=1e-9)
    # A coarse voxel is the union of fine ones: each mean lies in its cell.
    cell = np.floor(voxels.points() / voxels.edge)
    assert len({tuple(c) for c in cell}) == len(voxels)


def test_frames_in_any_order_make_one_map() -> None:
    rng = np.random.default_rng(1)
    clouds = [rng.normal(size=(200, 3)) for _ in range(3)]
    forward, backward = VoxelMap(0.3), VoxelMap(0.3)
    for cloud in clouds:
        forward.add(cloud, np.eye(4))
    for cloud in clouds[::-1]:
        backward.add(cloud, np.eye(4))
    np.testing.assert_allclose(forward.points(), backward.points(), atol=1e-12)


@pytest.mark.parametrize("edge", [0.0, -1.0, math.nan])
def test_a_voxel_needs_an_edge(edge: float) -> None:
    with pytest.raises(InvalidOptionError, match="positive length"):
        VoxelMap(edge)
