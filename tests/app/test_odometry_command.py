from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import open3d
import pytest
from depth_sequence import CAMERA, HEIGHT, WIDTH, rendered, write_depth, write_sequence
from scipy.spatial.transform import Rotation

from app.odometry_command import odometry_command
from model import Registrar
from model.cloud_file import read_points, write_points
from model.exceptions import EquivAlignError
from model.odometry import Tracker
from model.sequence import DepthFrames


@pytest.fixture(scope="module", autouse=True)
def one_registrar() -> Iterator[None]:
    """Loaded once for all the commands."""
    registrar = Registrar.load()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Registrar, "load", classmethod(lambda cls, artifact=None: registrar))
        yield


@pytest.fixture
def room(tmp_path: Path) -> Path:
    return write_sequence(tmp_path / "room", frames=7)


def run(room: Path, *arguments: object) -> int:
    return odometry_command([str(room), "--points", "500", *map(str, arguments)])


def tum(path: Path) -> np.ndarray:
    return np.loadtxt(path, ndmin=2)


def test_a_folder_goes_in_and_trajectories_a_map_and_a_report_come_out(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, kitti, cloud, page = (tmp_path / n for n in ("t.txt", "k.txt", "m.ply", "r.html"))
    assert run(room, "--out", out, "--kitti", kitti, "--map", cloud, "--report", page) == 0
    rows, matrices = tum(out), np.loadtxt(kitti).reshape(-1, 3, 4)
    assert rows.shape == (7, 8)
    np.testing.assert_allclose(rows[:, 0], 0.1 * np.arange(7), atol=1e-6)
    np.testing.assert_allclose(rows[:, 1:4], matrices[:, :, 3], atol=1e-8)
    turns = Rotation.from_quat(rows[:, 4:]).as_matrix()
    np.testing.assert_allclose(turns, matrices[:, :, :3], atol=1e-7)
    np.testing.assert_allclose(matrices[0], np.eye(4)[:3])
    measured = np.loadtxt(room / "groundtruth.txt")[:, 1:4]
    assert np.linalg.norm(rows[:, 1:4] - measured, axis=1).max() < 0.02
    # The first camera is the world, so the map lies on the walls.
    points = read_points(cloud, "map")
    assert len(points) > 500
    assert np.abs(points - [1.0, 0.8, 3.0]).min(axis=1).max() < 0.03
    html = page.read_text()
    for word in ("Trajectory", "Fused map", "ATE", "sorted by time", "measured"):
        assert word in html
    assert "http" not in html.split("</head>")[1].split("<script")[0]
    printed = capsys.readouterr().out
    assert "ATE" in printed
    assert "frames a second" in printed
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("k.txt", "m.ply", "r.html", "room", "t.txt")
    ]


def test_the_summary_as_json(room: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(room, "--json", "--every", 2) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["frames"] == {"first": 1, "tracked": 3}
    assert summary["ate"]["rmse"] < 0.02
    assert [error["gap"] for error in summary["rpe"]] == [1]
    assert summary["measured_poses"] == 4
    assert summary["frames_per_second"] > 0.0


def test_without_measured_poses_there_is_no_error_to_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = write_sequence(tmp_path / "room", frames=3, poses=False)
    page = tmp_path / "r.html"
    assert run(room, "--json", "--report", page) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["ate"] is None
    assert summary["rpe"] == []
    assert "ATE" not in page.read_text().split("<h2>Summary")[1].split("<h2>")[0]


class Stop:
    """Reads frames until one, then behaves as if the user had pressed Ctrl-C."""

    def __init__(self, at: int) -> None:
        self.at = at
        self.track = Tracker.track

    def __call__(self, tracker: Tracker, frame: object) -> object:
        if frame.number >= self.at:
            raise KeyboardInterrupt
        return self.track(tracker, frame)


def test_an_interrupted_run_goes_on_and_ends_as_if_nothing_had_been(
    room: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_depth(room / "depth" / "2.png", np.zeros((HEIGHT, WIDTH)))
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    files = ("--out", "t.txt"), ("--map", "m.ply"), ("--kitti", "k.txt")
    for folder in (whole, parts):
        folder.mkdir()
    arguments = {f: [w for o, n in files for w in (o, f / n)] for f in (whole, parts)}
    assert run(room, *arguments[whole]) == 0
    with monkeypatch.context() as patch:
        stop = Stop(4)
        patch.setattr(Tracker, "track", lambda tracker, frame: stop(tracker, frame))
        with pytest.raises(KeyboardInterrupt):
            run(room, *arguments[parts])
    assert len(tum(parts / "t.txt")) == 3  # 0, 1 and 3: nothing is to be seen in 2
    assert "goes on from there" in capsys.readouterr().err
    assert run(room, *arguments[parts]) == 0
    assert "after 4 frames" in capsys.readouterr().err
    assert (parts / "t.txt").read_bytes() == (whole / "t.txt").read_bytes()
    assert (parts / "k.txt").read_bytes() == (whole / "k.txt").read_bytes()
    assert (parts / "m.ply").read_bytes() == (whole / "m.ply").read_bytes()
    assert sorted(path.name for path in parts.iterdir()) == ["k.txt", "m.ply", "t.txt"]


@pytest.fixture
def unfinished(room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The trajectory of a run that was stopped at its third frame."""
    out = tmp_path / "t.txt"
    stop = Stop(2)
    with monkeypatch.context() as patch:
        patch.setattr(Tracker, "track", lambda tracker, frame: stop(tracker, frame))
        with pytest.raises(KeyboardInterrupt):
            run(room, "--out", out)
    return out


def test_a_run_of_other_settings_doesnt_go_on_from_there(room: Path, unfinished: Path) -> None:
    with pytest.raises(EquivAlignError, match="framing, tracker differ") as caught:
        run(room, "--out", unfinished, "--seed", 1)
    assert "delete it" in caught.value.mend
    assert len(tum(unfinished)) == 2


def test_a_broken_state_is_told_of(room: Path, unfinished: Path) -> None:
    state = unfinished.with_name("t.txt.unfinished.npz")
    state.write_bytes(state.read_bytes()[:200])
    with pytest.raises(EquivAlignError, match="can't be read"):
        run(room, "--out", unfinished)


def test_bad_frames_are_named_and_the_others_tracked(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_depth(room / "depth" / "2.png", np.zeros((HEIGHT, WIDTH)))
    (room / "depth" / "3.png").unlink()
    (room / "depth" / "5.png").write_bytes(b"\x89PNG but not for long")
    with (room / "depth.txt").open("a") as file:
        file.write("0.100000 depth/6.png\n")
    out = tmp_path / "t.txt"
    assert run(room, "--out", out, "--json") == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["frames"] == {"first": 1, "tracked": 3, "unreadable": 4}
    warnings = " ".join(printed.err.split())
    for word in (
        *("1 of 8 depth images are missing", "out of order", "1 frames have the time of another"),
        *("(2.png)", "shows too little", "(3.png)", "is missing", "(5.png)", "isn't later"),
    ):
        assert word in warnings
    np.testing.assert_allclose(tum(out)[:, 0], [0.0, 0.1, 0.4, 0.6], atol=1e-6)


def test_a_wrong_calibration_ends_the_run_at_once(room: Path, tmp_path: Path) -> None:
    (room / "calibration.txt").write_text("585 585 320 240\n")
    with pytest.raises(EquivAlignError, match="80×60 pixels") as caught:
        run(room, "--out", tmp_path / "t.txt")
    assert caught.value.field == "calibration"
    assert [path.name for path in tmp_path.iterdir()] == ["room"]


def test_what_goes_wrong_in_the_middle_leaves_the_trajectory_so_far(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = DepthFrames.read

    def other_camera(frames: DepthFrames, number: int, most: int, seed: int):
        seen = read(frames, number, most, seed)
        if number == 4:
            CAMERA.require_fits(6, 8)
        return seen

    monkeypatch.setattr(DepthFrames, "read", other_camera)
    out = tmp_path / "t.txt"
    with pytest.raises(EquivAlignError, match="calibration"):
        run(room, "--out", out)
    assert len(tum(out)) == 4


def test_a_sequence_that_shows_nothing_is_refused(tmp_path: Path) -> None:
    room = write_sequence(tmp_path / "room", frames=3)
    for number in range(3):
        write_depth(room / "depth" / f"{number}.png", np.zeros((HEIGHT, WIDTH)))
    with pytest.raises(EquivAlignError, match="no frame of the sequence could be used"):
        run(room)


def test_a_folder_of_clouds_in_any_unit(tmp_path: Path) -> None:
    folder, out = tmp_path / "scans", tmp_path / "t.txt"
    folder.mkdir()
    for number in range(4):
        T = np.eye(4)
        T[:3, 3] = [0.02 * number, 0.0, 0.03 * number]
        write_points(folder / f"{number:03}.ply", 1000.0 * CAMERA.back_projected(rendered(T)))
    assert run(folder, "--out", out) == 0
    expected = 1000.0 * np.outer(np.arange(4), [0.02, 0.0, 0.03])
    np.testing.assert_allclose(tum(out)[:, 1:4], expected, atol=15.0)


def test_the_map_has_the_frames_colours(room: Path, tmp_path: Path) -> None:
    (room / "rgb").mkdir()
    listed = []
    for number in range(7):
        image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        image[:] = (200, 100, 50)
        path = room / "rgb" / f"{number}.png"
        assert open3d.io.write_image(str(path), open3d.geometry.Image(image))
        listed.append(f"{0.1 * number:.6f} rgb/{number}.png")
    (room / "rgb.txt").write_text("\n".join(listed) + "\n")
    cloud = tmp_path / "m.ply"
    assert run(room, "--colour", "--map", cloud, "--frames", "0-2") == 0
    read = open3d.io.read_point_cloud(str(cloud))
    np.testing.assert_allclose(np.asarray(read.points), read_points(cloud, "map"))
    np.testing.assert_allclose(
        np.asarray(read.colors), np.tile([200, 100, 50], (len(read.points), 1)) / 255.0, atol=0.005
    )


def test_colour_is_asked_for_where_there_is_none(
    room: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(EquivAlignError, match="no frame of the sequence could be used"):
        run(room, "--colour")
    assert "there is no colour image" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["--out", "absent/t.txt"], "out"),
        (["--report", "absent/r.html"], "report"),
        (["--map", "m.jpg"], "map"),
        (["--frames", "5-90"], "frames"),
        (["--every", "0"], "every"),
        (["--points", "3"], "points"),
        (["--seed", "-1"], "seed"),
        (["--voxel", "0"], "voxel"),
        (["--max-depth", "-2"], "max_depth"),
    ],
)
def test_options_that_cant_be_are_named_before_the_work(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], field: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(EquivAlignError) as caught:
        odometry_command([str(room), *arguments])
    assert caught.value.field == field
    assert caught.value.mend
    assert [path.name for path in tmp_path.iterdir()] == ["room"]


def test_sensor_weights_need_a_sensor(tmp_path: Path) -> None:
    write_points(tmp_path / "0.ply", np.random.default_rng(0).normal(size=(50, 3)))
    with pytest.raises(EquivAlignError, match="doesn't tell its sensor"):
        run(tmp_path, "--sensor-weights")


def test_a_real_kitchen_is_followed(
    data_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kitchen = data_root / "rgbd" / "redkitchen_a"
    arguments = ["--frames", "600-630", "--every", "3", "--json"]
    assert odometry_command([str(kitchen), *arguments, "--out", str(tmp_path / "t.txt")]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["frames"] == {"first": 1, "tracked": 10}
    assert summary["ate"]["rmse"] < 0.02
    # The measured poses are off by some millimetres themselves.
    assert summary["rpe"][0]["rotation_deg"]["mean"] < 0.4
    assert summary["rpe"][0]["translation"]["mean"] < 0.008


def test_the_guides_python_follows_a_camera(room: Path, capsys: pytest.CaptureFixture[str]) -> None:
    guide = (Path(__file__).parents[2] / "docs" / "odometry.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```$", guide, re.MULTILINE | re.DOTALL)
    exec(example.replace("SEQUENCE", str(room)), {})
    assert capsys.readouterr().out.count("tracked") == 6


def test_the_guides_options_exist(capsys: pytest.CaptureFixture[str]) -> None:
    guide = (Path(__file__).parents[2] / "docs" / "odometry.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(--[a-z-]+)", guide)) - {"--data", "--model"}
    with pytest.raises(SystemExit):
        odometry_command(["--help"])
    assert named <= set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
