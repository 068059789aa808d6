from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.command_line import benchmark_command
from benchmarks.frame_pairs import FramePairMaker, list_frame_pairs
from benchmarks.pose_error import PoseError
from benchmarks.results import read_results
from benchmarks.sequence_options import sequence_folders
from benchmarks.summary import Summary, cells, rows_by_method
from model.exceptions import InvalidOptionError
from model.sequence import Camera, read_sequence

WIDTH, HEIGHT = 120, 90
CAMERA = Camera(105.0, 105.0, 59.5, 44.5)


def corner_depth(T_world_camera: np.ndarray) -> np.ndarray:
    """(HEIGHT, WIDTH) metres, seen from inside a corner of three walls."""
    column, row = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    ray = np.stack(
        [(column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy, np.ones(row.shape)], -1
    )
    direction = ray @ T_world_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        depth = (np.array([0.8, 0.6, 2.0]) - T_world_camera[:3, 3]) / direction
    return np.asarray(np.where(depth > 0.0, depth, np.inf).min(-1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames of a camera that turns and drifts."""
    root = tmp_path_factory.mktemp("frames") / "corner"
    (root / "depth").mkdir(parents=True)
    (root / "calibration.txt").write_text("105 105 59.5 44.5\n")
    images, poses = [], []
    for i in range(5):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec([0.01 * i, 0.03 * i, 0.0]).as_matrix()
        T[:3, 3] = [0.02 * i, 0.0, 0.03 * i]
        pixels = np.round(5000 * corner_depth(T)).astype(np.uint16)
        image = open3d.geometry.Image(np.ascontiguousarray(pixels))
        assert open3d.io.write_image(root / "depth" / f"{i}.png", image)
        images.append(f"{0.1 * i:.6f} depth/{i}.png")
        numbers = [*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()]
        poses.append(f"{0.1 * i:.6f} " + " ".join(f"{value:.9f}" for value in numbers))
    (root / "depth.txt").write_text("\n".join(images))
    (root / "groundtruth.txt").write_text("\n".join(poses))
    return root


def test_the_extra_rotation_adds_to_the_measured_pose(folder: Path) -> None:
    sequence = read_sequence(folder)
    entries = list_frame_pairs(sequence, range(5), [2], ["as-is", "extra-10"], None, seed=0)
    assert len(entries) == 6
    maker = FramePairMaker(sequence, 300, seed=0)
    still, turned = maker.make(entries[0]), maker.make(entries[1])
    assert np.array_equal(still.target, turned.target)
    measured = sequence.relative_pose(0, 2)
    assert measured is not None
    assert np.allclose(still.T_target_source, measured)
    off = PoseError.of(still.T_target_source, turned)
    assert off.rotation_deg == pytest.approx(10.0, abs=1e-4)
    assert off.translation == pytest.approx(0.0, abs=1e-9)
    for pair in (still, turned):
        R, t = pair.T_target_source[:3, :3], pair.T_target_source[:3, 3]
        moved = pair.source @ R.T + t
        assert np.abs(moved - [0.8, 0.6, 2.0]).min(axis=1).max() < 0.01


def test_methods_are_run_on_frames(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "frames.json"
    argv = [
        *("rgbd", "--sequence", str(folder), "--frames", "0-4", "--gaps", "1"),
        *("--points", "400", "--limit", "2", "--methods", "identity,icp", "--out", str(out)),
    ]
    assert benchmark_command(argv) == 0
    results = read_results(out)
    assert [(cell.turn, cell.column) for cell in cells(results)] == [
        ("gap 1", "as-is"),
        ("gap 1", "extra-10"),
    ]
    answers = rows_by_method(results, cells(results)[1])
    icp, identity = Summary.of(answers["icp"]), Summary.of(answers["identity"])
    assert icp.rotation_mean < 0.5
    assert icp.centroid_mean < 0.02
    assert 7.0 < identity.rotation_mean < 13.0
    assert icp.adds_mean is None


def test_sequences_are_measured_apart_and_together(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "corner").symlink_to(folder)
    (tmp_path / "again").symlink_to(folder)
    out = tmp_path / "frames.json"
    argv = [
        *("rgbd", "--sequence", str(tmp_path), "--gaps", "2", "--columns", "extra-10"),
        *("--points", "200", "--limit", "2", "--methods", "identity", "--out", str(out)),
    ]
    assert benchmark_command(argv) == 0
    results = read_results(out)
    by_group = {c.group: rows_by_method(results, c)["identity"] for c in cells(results)}
    assert {group: len(rows) for group, rows in by_group.items()} == {
        "again": 2,
        "corner": 2,
        "all sequences": 4,
    }
    with pytest.raises(InvalidOptionError, match="two sequences have one name"):
        sequence_folders([folder, folder])


def test_all_frames_means_those_with_known_poses(folder: Path) -> None:
    sequence = read_sequence(folder)
    sequence.frames[1] = replace(sequence.frames[1], T_world_camera=None)
    entries = list_frame_pairs(sequence, None, [1], ["as-is"], None, seed=0)
    assert [entry.subject for entry in entries] == [2, 3]
    with pytest.raises(InvalidOptionError, match="poses of 1 frames"):
        list_frame_pairs(sequence, range(5), [1], ["as-is"], None, seed=0)


def test_frames_that_are_not_there_are_refused(folder: Path) -> None:
    sequence = read_sequence(folder)
    with pytest.raises(InvalidOptionError, match="frames 0–4"):
        list_frame_pairs(sequence, range(600, 700), [1], ["as-is"], None, seed=0)
    with pytest.raises(InvalidOptionError, match="gaps"):
        list_frame_pairs(sequence, range(5), [5], ["as-is"], None, seed=0)


def test_icp_on_real_frames_is_as_good_as_it_should_be(data_root: Path, tmp_path: Path) -> None:
    out = tmp_path / "kitchen.json"
    argv = [
        *("rgbd", "--sequence", str(data_root / "rgbd" / "redkitchen_a"), "--gaps", "1,30"),
        *(
            "--frames",
            "600-699",
            "--columns",
            "extra-10",
            "--limit",
            "6",
            "--methods",
            "icp",
            "--out",
            str(out),
        ),
    ]
    assert benchmark_command(argv) == 0
    results = read_results(out)
    near, far = (Summary.of(rows_by_method(results, cell)["icp"]) for cell in cells(results))
    assert near.rotation_mean < 0.3
    assert far.rotation_mean < 1.2
    assert near.centroid_mean < 0.005
