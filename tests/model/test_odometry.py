from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from depth_sequence import CAMERA, rendered, write_depth, write_sequence
from scipy.spatial.transform import Rotation

from model import Registrar
from model.exceptions import InvalidCloudError, InvalidOptionError, TooFewPointsError
from model.labels import sharp_colour_labels
from model.odometry import (
    AbsoluteError,
    ConstantVelocity,
    Cycle,
    DepthNoise,
    FramePreparer,
    Framing,
    Keyframe,
    Keyframes,
    RelativeError,
    Status,
    Step,
    Tracker,
    TrackerSettings,
    VoxelMap,
    stream,
)
from model.sequence import FrameCloud, open_frames


@pytest.fixture(scope="module")
def registrar() -> Registrar:
    return Registrar.load()


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten frames of a corner with two boxes in it, each turned by 2.6° from the last."""
    return write_sequence(tmp_path_factory.mktemp("odometry") / "room", frames=10)


def motion(angle_deg: float, axis: tuple[float, ...], t: tuple[float, ...]) -> np.ndarray:
    T = np.eye(4)
    unit = np.array(axis) / np.linalg.norm(axis)
    T[:3, :3] = Rotation.from_rotvec(math.radians(angle_deg) * unit).as_matrix()
    T[:3, 3] = t
    return T


def follow(
    registrar: Registrar, room: Path, mode: str = "keyframe", **framing: object
) -> list[Step]:
    preparer = FramePreparer(registrar, Framing(points=600, **framing))
    frames = open_frames(room)
    tracker = Tracker(preparer, TrackerSettings(mode=mode))
    return [streamed.step for streamed in stream(frames, range(len(frames)), tracker)]


def errors(room: Path, steps: list[Step]) -> tuple[np.ndarray, np.ndarray]:
    """Degrees and metres of each pose, the first frame's being right."""
    frames = open_frames(room)
    T_first = frames.T_world_camera(steps[0].number)
    left = [
        np.linalg.inv(np.linalg.inv(T_first) @ frames.T_world_camera(step.number))
        @ step.T_world_camera
        for step in steps
    ]
    turns = [np.degrees(Rotation.from_matrix(T[:3, :3]).magnitude()) for T in left]
    return np.array(turns), np.array([np.linalg.norm(T[:3, 3]) for T in left])


@pytest.mark.parametrize("mode", ["keyframe", "frame"])
def test_the_camera_is_followed(registrar: Registrar, room: Path, mode: str) -> None:
    steps = follow(registrar, room, mode)
    assert [step.status for step in steps] == [Status.FIRST] + [Status.TRACKED] * 9
    turns, shifts = errors(room, steps)
    assert turns.max() < 0.5
    assert shifts.max() < 0.02
    keys = sum(step.keyframe for step in steps)
    assert keys == 10 if mode == "frame" else keys < 10
    # In a corner of three walls the frames are never doubtful.
    assert all(step.success_probability > 0.5 for step in steps[1:])


def test_the_same_frames_give_the_same_trajectory(registrar: Registrar, room: Path) -> None:
    once, again = (follow(registrar, room)[-1].T_world_camera for _ in range(2))
    np.testing.assert_array_equal(once, again)


def test_a_frame_of_zeros_is_told_of_and_the_next_is_tracked(
    registrar: Registrar, tmp_path: Path
) -> None:
    room = write_sequence(tmp_path / "room", frames=7)
    write_depth(room / "depth" / "3.png", np.zeros((60, 80)))
    (room / "depth" / "4.png").write_bytes(b"no image")
    steps = follow(registrar, room)
    statuses = [step.status for step in steps]
    assert statuses[3:5] == [Status.UNREADABLE] * 2
    assert set(statuses[:3] + statuses[5:]) == {Status.FIRST, Status.TRACKED}
    assert "shows too little" in steps[3].warning
    assert "4.png" in steps[4].warning
    turns, shifts = errors(room, [step for step in steps if step.status.has_pose])
    assert turns.max() < 0.5
    assert shifts.max() < 0.02


def test_frames_of_another_place_are_lost_and_the_camera_is_found_again(
    registrar: Registrar, tmp_path: Path
) -> None:
    room = write_sequence(tmp_path / "room", frames=8)
    # Depth that no camera in the corner sees: a wall of waves.
    row, column = np.mgrid[:60, :80]
    elsewhere = 0.9 + 0.25 * np.sin(0.4 * column) * np.cos(0.5 * row) + 0.004 * column
    for number in (3, 4):
        write_depth(room / "depth" / f"{number}.png", elsewhere)
    steps = follow(registrar, room)
    assert [step.status.has_pose for step in steps[3:5]] == [False, False]
    assert all(step.warning for step in steps[3:5])
    back = steps[5:]
    assert all(step.status.has_pose for step in back)
    # Against the first frame, not the first of those that came back.
    frames = open_frames(room)
    for step in back:
        true = np.linalg.inv(frames.T_world_camera(0)) @ frames.T_world_camera(step.number)
        off = np.linalg.inv(true) @ step.T_world_camera
        assert np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()) < 1.0
        assert np.linalg.norm(off[:3, 3]) < 0.03


def prepared(registrar: Registrar, points: np.ndarray, number: int = 0, time: float = 0.0):
    framing = Framing(points=len(points), least_points=4)
    return FramePreparer(registrar, framing).prepare(number, time, FrameCloud(points))


def boxes(seed: int, n: int = 700) -> np.ndarray:
    """(n, 3) of a lopsided heap of boxes: nothing like it when it is turned."""
    rng = np.random.default_rng(seed)
    parts = []
    for size, centre in (
        ((2.0, 1.2, 0.4), (0.0, 0.0, 0.0)),
        ((0.5, 0.5, 1.1), (0.6, 0.2, 0.7)),
        ((0.4, 0.9, 0.5), (-0.7, 0.1, 0.4)),
        ((1.2, 0.2, 0.3), (0.1, -0.5, 0.35)),
    ):
        u = rng.uniform(-0.5, 0.5, (n // 4, 3))
        face = rng.integers(0, 3, n // 4)
        u[np.arange(n // 4), face] = 0.5 * rng.choice([-1.0, 1.0], n // 4)
        parts.append(u * size + centre)
    return np.concatenate(parts) + 0.003 * rng.normal(size=(4 * (n // 4), 3))


def test_a_camera_that_was_carried_away_is_found_by_a_global_search(registrar: Registrar) -> None:
    T = motion(110.0, (0.3, 1.0, 0.2), (0.8, -0.3, 0.5))
    tracker = Tracker(FramePreparer(registrar, Framing(points=700)))
    tracker.track(prepared(registrar, boxes(0), 0, 0.0))
    seen = (boxes(1) - T[:3, 3]) @ T[:3, :3]
    step = tracker.track(prepared(registrar, seen, 1, 0.1))
    assert step.status is Status.RELOCALISED
    off = np.linalg.inv(T) @ step.T_world_camera
    assert np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()) < 1.0
    # A jump says nothing about the velocity.
    assert tracker.motion is not None
    np.testing.assert_array_equal(tracker.motion.predict(0.2), step.T_world_camera)


def test_after_many_lost_frames_the_trajectory_goes_on_from_the_guess(
    registrar: Registrar,
) -> None:
    settings = TrackerSettings(restart_after=1)
    tracker = Tracker(FramePreparer(registrar, Framing(points=700)), settings)
    tracker.track(prepared(registrar, boxes(0), 0, 0.0))
    ball = np.random.default_rng(0).normal(size=(700, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    statuses = [
        tracker.track(prepared(registrar, ball * (1.0 + 0.2 * k), k, 0.1 * k)).status
        for k in (1, 2)
    ]
    assert statuses == [Status.LOST, Status.RESTARTED]


def test_a_frame_that_shows_too_little_is_refused(registrar: Registrar) -> None:
    preparer = FramePreparer(registrar, Framing())
    with pytest.raises(TooFewPointsError, match="shows too little"):
        preparer.prepare(0, 0.0, FrameCloud(np.ones((20, 3))))


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


def test_few_keyframes_are_kept_and_the_latest_always(registrar: Registrar) -> None:
    frame = prepared(registrar, boxes(0, 80))
    kept = Keyframes(4)
    places = [0.0, 1.0, 1.1, 2.0, 3.0, 4.0]
    for place in places:
        kept.add(Keyframe(frame, motion(0.0, (1, 0, 0), (place, 0, 0))))
    at = [keyframe.T_world_camera[0, 3] for keyframe in kept]
    assert len(at) == 4
    assert at[-1] == 4.0
    assert not {1.0, 1.1} <= set(at)
    order = [k.T_world_camera[0, 3] for k in kept.near(motion(0.0, (1, 0, 0), (0.1, 0, 0)))]
    assert order[:2] == [4.0, 0.0]


def test_a_keyframe_that_is_passed_gives_its_views_back(registrar: Registrar) -> None:
    frames = [prepared(registrar, boxes(k), k, 0.1 * k) for k in range(3)]
    tracker = Tracker(FramePreparer(registrar, Framing(points=700)), TrackerSettings(mode="frame"))
    for frame in frames:
        tracker.track(frame)
    assert not frames[0].cloud.cloud.dense._known


def test_views_of_a_cloud_that_serves_many_pairs_stay_few(registrar: Registrar) -> None:
    dense = prepared(registrar, boxes(0)).cloud.cloud.dense
    views = [dense.at(0.1 + 0.01 * k) for k in range(40)]
    assert len(dense._known) < 20
    assert dense.at(0.1 + 0.01 * 39) is views[-1]


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


def test_depth_noise_grows_with_the_square() -> None:
    noise = DepthNoise()
    near, far, farther = noise.sigma(np.array([1.4, 2.4, 4.4])) - noise.floor
    assert far == pytest.approx(4.0 * near)
    assert farther == pytest.approx(16.0 * near)
    weights = noise.weights(np.linspace(0.5, 8.0, 20))
    assert (np.diff(weights) < 0.0).all()
    assert 0.9 < weights[0] <= 1.0


def test_what_weighs_nothing_doesnt_move_the_pose(registrar: Registrar) -> None:
    T = motion(1.5, (0.2, 1.0, 0.1), (0.02, -0.01, 0.03))
    target, still = boxes(0, 600), (boxes(1, 600) - T[:3, 3]) @ T[:3, :3]
    # A chair that was pushed between the frames.
    chair = 0.5 * boxes(2, 600) + [0.0, 1.2, 0.2]
    pushed = (0.5 * boxes(3, 600) + [0.08, 1.2, 0.2] - T[:3, 3]) @ T[:3, :3]
    off = {}
    for least in (1.0, 1e-3):
        weights = np.r_[np.ones(600), np.full(600, least)]
        x = registrar.prepare(np.r_[target, chair], weights=weights, unit=1.5)
        z = registrar.prepare(np.r_[still, pushed], weights=weights, unit=1.5)
        found = registrar.register(z, x, initial=np.eye(4), search="local").T_target_source
        off[least] = np.linalg.norm((np.linalg.inv(T) @ found)[:3, 3])
    assert off[1.0] > 0.015
    assert off[1e-3] < 0.01


@pytest.mark.parametrize(
    "weights", [np.ones(5), -np.ones(700), np.zeros(700), np.full(700, np.nan)]
)
def test_weights_that_mean_nothing_are_refused(registrar: Registrar, weights: np.ndarray) -> None:
    with pytest.raises(InvalidCloudError) as caught:
        registrar.prepare(boxes(0, 700), weights=weights)
    assert caught.value.field == "target_weights"


def test_clouds_prepared_in_one_unit_give_the_answer_of_the_pair(registrar: Registrar) -> None:
    T = motion(5.0, (0.2, 1.0, 0.1), (0.05, -0.1, 0.03))
    target, source = boxes(0, 700), (boxes(1, 700) - T[:3, 3]) @ T[:3, :3]
    x, z = (registrar.prepare(points, unit=1.5) for points in (target, source))
    other = registrar.prepare(source, unit=1.8)
    plain = registrar.register(source, target).T_target_source
    for ready in (z, other):
        np.testing.assert_allclose(registrar.register(ready, x).T_target_source, plain, atol=2e-3)


def wall(seed: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a camera at a place (3,) sees of a long, flat, painted wall: points, colours (n, 3)."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1.0, 1.0, (2, 1500)) * np.array([[1.2], [0.9]])
    points = np.c_[x, y, 2.0 + 0.002 * rng.normal(size=1500)]
    x, y = x + at[0], y + at[1]
    shades = [7 * x + 2 * y, 9 * y - 3 * x + 1, 5 * x - 6 * y + 2]
    return points, np.stack([0.5 + 0.5 * np.sin(shade) for shade in shades], axis=1)


def test_colour_holds_a_flat_wall_where_geometry_alone_slides(registrar: Registrar) -> None:
    T = motion(0.0, (0, 0, 1), (0.15, -0.1, 0.0))
    (x, x_colours), (z, z_colours) = wall(0, np.zeros(3)), wall(1, T[:3, 3])
    guess = {"initial": np.eye(4), "search": "local"}
    bare = registrar.register(z, x, **guess)
    painted = registrar.register(
        z,
        x,
        source_labels=sharp_colour_labels(z_colours),
        target_labels=sharp_colour_labels(x_colours),
        **guess,
    )
    assert bare.diagnostics.degenerate_directions
    slid = np.linalg.norm((bare.T_target_source - T)[:3, 3])
    held = np.linalg.norm((painted.T_target_source - T)[:3, 3])
    assert slid > 0.1
    assert held < 0.01


def test_the_tracker_compares_colours_when_it_is_told_to(registrar: Registrar) -> None:
    T = motion(0.0, (0, 0, 1), (0.15, -0.1, 0.0))
    (x, x_colours), (z, z_colours) = wall(0, np.zeros(3)), wall(1, T[:3, 3])
    found = {}
    for colour in (False, True):
        preparer = FramePreparer(registrar, Framing(points=1500, colour=colour))
        tracker = Tracker(preparer)
        tracker.track(preparer.prepare(0, 0.0, FrameCloud(x, np.float32(x_colours))))
        seen = FrameCloud(z, np.float32(z_colours))
        found[colour] = tracker.track(preparer.prepare(1, 0.1, seen)).T_world_camera
    off = {colour: np.linalg.norm((T_found - T)[:3, 3]) for colour, T_found in found.items()}
    assert off[False] > 0.1
    assert off[True] < 0.01


def test_shades_are_told_apart_by_their_labels() -> None:
    shades = np.array([[0.2, 0.5, 0.7], [0.25, 0.5, 0.7], [0.5, 0.5, 0.7], [0.9, 0.1, 0.0]])
    alike = sharp_colour_labels(shades) @ sharp_colour_labels(shades)[0]
    assert alike[0] == pytest.approx(1.0)
    assert alike[0] > alike[1] > alike[2] > alike[3]
    assert alike[1] > 0.95
    assert alike[3] < 0.2


@pytest.mark.parametrize(
    "options", [{"mode": "both"}, {"keyframe_overlap": 0.0}, {"keyframe_overlap": 1.5}]
)
def test_settings_out_of_their_range_are_named(options: dict) -> None:
    with pytest.raises(InvalidOptionError) as caught:
        TrackerSettings(**options)
    assert caught.value.field in options


def test_a_wider_view_gets_a_unit_of_its_own_and_is_still_tracked(registrar: Registrar) -> None:
    preparer = FramePreparer(registrar, Framing(points=700, least_points=4))
    tracker = Tracker(preparer)
    tracker.track(preparer.prepare(0, 0.0, FrameCloud(boxes(0))))
    unit = preparer.unit
    # The same heap, and a far wall that came into view.
    rng = np.random.default_rng(5)
    far = np.c_[rng.uniform(-3, 3, (300, 2)), np.full(300, 4.0)]
    wider = np.concatenate([boxes(1), far])
    step = tracker.track(preparer.prepare(1, 0.1, FrameCloud(wider)))
    assert preparer.unit != unit
    assert step.status.has_pose
    assert step.keyframe
    assert np.linalg.norm(step.T_world_camera[:3, 3]) < 0.05


def test_the_cameras_of_the_rendered_room_agree() -> None:
    # What the other tests rest on: the renderer's depth is what the pinhole back-projects.
    T = motion(10.0, (0, 1, 0), (0.1, 0.0, 0.2))
    points = CAMERA.back_projected(rendered(T)) @ T[:3, :3].T + T[:3, 3]
    assert np.abs(points - [1.0, 0.8, 3.0]).min(axis=1).max() < 1e-9
