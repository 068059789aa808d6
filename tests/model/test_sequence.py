from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from depth_sequence import CAMERA, HEIGHT, WIDTH, write_sequence

from model.cloud_file import write_points
from model.exceptions import CloudFileError, EquivAlignError, InvalidOptionError
from model.sequence import CloudFrames, DepthFrames, farthest_rows, open_frames, read_sequence


@pytest.fixture
def room(tmp_path: Path) -> Path:
    return write_sequence(tmp_path / "room")


def test_a_list_that_is_out_of_order_is_sorted_and_told_of(room: Path) -> None:
    frames = open_frames(room)
    times = [frames.time(number) for number in range(len(frames))]
    assert times == sorted(times)
    assert any("out of order" in note for note in frames.notes)


def test_times_in_order_leave_no_note(room: Path) -> None:
    rows = (room / "depth.txt").read_text().splitlines()
    (room / "depth.txt").write_text("\n".join([rows[0], *rows[:0:-1]]) + "\n")
    assert list(open_frames(room).notes) == []


def test_frames_of_one_time_are_told_of(room: Path) -> None:
    with (room / "depth.txt").open("a") as file:
        file.write("0.000000 depth/0.png\n")
    assert any("1 frames have the time of another" in note for note in open_frames(room).notes)


def test_a_missing_image_is_refused_only_when_it_is_read(room: Path) -> None:
    (room / "depth" / "2.png").unlink()
    with pytest.raises(EquivAlignError, match="1 of 6 depth images are missing"):
        read_sequence(room)
    frames = open_frames(room)
    assert any("1 of 6 depth images are missing" in note for note in frames.notes)
    assert len(frames.read(1, 100, seed=0).points) == 100
    with pytest.raises(CloudFileError, match=r"2\.png"):
        frames.read(2, 100, seed=0)


def test_a_folder_whose_images_are_all_missing_is_refused(room: Path) -> None:
    for image in (room / "depth").iterdir():
        image.unlink()
    with pytest.raises(CloudFileError, match="6 of 6"):
        open_frames(room)


@pytest.mark.parametrize(
    "calibration",
    [
        "700 720 395 295",  # ten times as many pixels
        "70 720 39.5 29.5",  # a slip of the pen
        "7 7.2 39.5 29.5",
        "7000 7200 39.5 29.5",
        "70 72 -39.5 29.5",
    ],
)
def test_a_calibration_of_another_camera_is_named(room: Path, calibration: str) -> None:
    (room / "calibration.txt").write_text(calibration + "\n")
    with pytest.raises(InvalidOptionError, match="80×60 pixels") as caught:
        open_frames(room).read(0, 100, seed=0)
    assert caught.value.field == "calibration"
    assert caught.value.value == calibration
    assert caught.value.mend


def test_the_right_calibration_passes() -> None:
    CAMERA.require_fits(HEIGHT, WIDTH)


def test_a_frame_gives_some_of_its_pixels_the_same_every_time(room: Path) -> None:
    frames = open_frames(room)
    once, again = (frames.read(0, 500, seed=3).points for _ in range(2))
    np.testing.assert_array_equal(once, again)
    every = {tuple(point) for point in read_sequence(room).cloud(0)}
    assert {tuple(point) for point in once} <= every
    assert len({tuple(point) for point in once}) == 500
    assert not np.array_equal(once, frames.read(0, 500, seed=4).points)


def test_clouds_are_counted_as_people_do(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(30, 3))
    for number in (10, 9, 1):
        write_points(tmp_path / f"scan_{number}.ply", points + number)
    frames = open_frames(tmp_path)
    assert isinstance(frames, CloudFrames)
    assert [frames.file(k) for k in range(3)] == ["scan_1.ply", "scan_9.ply", "scan_10.ply"]
    assert [frames.time(k) for k in range(3)] == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(frames.read(1, 1000, seed=0).points, points + 9)
    assert len(frames.read(1, 7, seed=0).points) == 7


def test_what_a_sensor_didnt_see_is_left_out(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(30, 3))
    blind = np.r_[points, np.full((5, 3), np.nan), np.zeros((4, 3))]
    np.save(tmp_path / "0.npy", blind)
    np.testing.assert_array_equal(open_frames(tmp_path).read(0, 100, seed=0).points, points)


def test_names_that_are_times_are_the_times(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(30, 3))
    for time in ("12.5", "2.25"):
        write_points(tmp_path / f"{time}.xyz", points)
    (tmp_path / "groundtruth.txt").write_text("2.251 1 2 3 0 0 0 1\n")
    frames = open_frames(tmp_path)
    assert [frames.time(k) for k in range(2)] == [2.25, 12.5]
    T = frames.T_world_camera(0)
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], [1, 2, 3])
    assert frames.T_world_camera(1) is None


def test_folders_that_hold_no_sequence_are_refused(tmp_path: Path) -> None:
    with pytest.raises(EquivAlignError, match="no such folder"):
        open_frames(tmp_path / "nowhere")
    with pytest.raises(EquivAlignError, match="nor files of clouds"):
        open_frames(tmp_path)
    write_points(tmp_path / "0.ply", np.eye(3))
    with pytest.raises(EquivAlignError, match="no depth images"):
        open_frames(tmp_path, colour=True)


def test_a_sequence_without_calibration_is_asked_for_one(room: Path) -> None:
    (room / "calibration.txt").unlink()
    with pytest.raises(EquivAlignError, match=r"calibration\.txt"):
        open_frames(room)


def test_depth_beyond_the_limit_is_left_out(room: Path) -> None:
    frames = open_frames(room, max_depth=2.5)
    assert isinstance(frames, DepthFrames)
    assert frames.read(0, 10_000, seed=0).points[:, 2].max() <= 2.5


def test_farthest_rows_are_far_from_each_other() -> None:
    points = np.random.default_rng(0).normal(size=(2000, 3))
    rows = farthest_rows(points, 50)
    assert len(set(rows.tolist())) == 50
    chosen = points[rows]
    apart = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1) + 9.0 * np.eye(50)
    covered = np.linalg.norm(points[:, None] - chosen[None], axis=-1).min(axis=1)
    # Nothing is farther from the chosen than these are from each other.
    assert covered.max() <= apart.min() + 1e-12
