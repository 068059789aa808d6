from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from depth_sequence import CAMERA, rendered, write_depth, write_sequence
from heap import boxes, motion
from scipy.spatial.transform import Rotation

from model import Registrar
from model.exceptions import InvalidOptionError, TooFewPointsError
from model.odometry import (
    FramePreparer,
    Framing,
    Keyframe,
    Keyframes,
    Status,
    Step,
    Tracker,
    TrackerSettings,
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
