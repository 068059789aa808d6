from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from depth_sequence import write_sequence

from benchmarks.command_line import benchmark_command
from benchmarks.odometry.followers import LocalFollower, SampledFrame, as_measured
from benchmarks.odometry.local_methods import LocalIcp, LocalSmallGicp
from benchmarks.odometry.residual import HeldOutSurface
from benchmarks.odometry.scores import TrajectoryScore
from benchmarks.speed_file import SpeedResults, read_speed
from model.exceptions import EquivAlignError
from model.sequence import DepthFrames, read_sequence


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sequence(tmp_path_factory.mktemp("odometry") / "room", frames=8)


@pytest.fixture(scope="module")
def results(
    room: Path, tmp_path_factory: pytest.TempPathFactory, small_artifact: Path
) -> tuple[SpeedResults, str]:
    """Both modes, and one pair of each gap; and the report."""
    folder = tmp_path_factory.mktemp("results")
    out = folder / "odometry.json"
    arguments = [
        *("odometry", "--sequence", str(room), "--every", "1", "--points", "300"),
        *("--methods", "ours,ours_adapted,icp", "--artifact", str(small_artifact)),
        *("--adapted", str(small_artifact), "--pairs", "1", "--gaps", "1,2"),
        *("--columns", "extra-10", "--out", str(out)),
    ]
    assert benchmark_command(arguments) == 0
    assert benchmark_command(["report", str(out), "--out", str(folder / "report.md")]) == 0
    return read_speed(out), (folder / "report.md").read_text()


def test_every_method_follows_the_same_frames_in_both_modes(
    results: tuple[SpeedResults, str],
) -> None:
    for sheet, mode in zip(results[0].sheets[:2], ("keyframe", "frame"), strict=True):
        assert sheet.title == f"room, 8 frames, {mode}"
        assert [row[0] for row in sheet.rows] == ["ours", "ours_adapted", "icp", "measured"]
        ours, adapted, icp, measured = sheet.rows
        # The same artifact twice gives the same trajectory twice.
        assert ours[1:-1] == adapted[1:-1]
        assert float(ours[1]) < 20.0
        assert float(icp[1]) < 50.0
        assert measured[1:3] == ["0.0", "0.0"]
        assert measured[-1] == "–"


def test_pairs_have_a_table_a_gap(results: tuple[SpeedResults, str]) -> None:
    titles = [sheet.title for sheet in results[0].sheets[2:]]
    assert titles == ["room, pairs, gap 1, extra-10", "room, pairs, gap 2, extra-10"]
    for sheet in results[0].sheets[2:]:
        assert [row[0] for row in sheet.rows] == ["ours", "ours_adapted", "icp", "measured"]
        assert sheet.rows[-1][2] == "0.000"


def test_the_report_shows_every_table(results: tuple[SpeedResults, str]) -> None:
    for sheet in results[0].sheets:
        assert f"### {sheet.title}" in results[1]


def test_the_residual_is_least_at_the_true_pose(room: Path) -> None:
    sequence = read_sequence(room)
    source = DepthFrames(sequence)
    here, there = (HeldOutSurface.of(source, number, 0) for number in (0, 1))
    T = sequence.relative_pose(0, 1)
    assert T is not None
    true = here.residual(there, T)
    assert true < 0.001
    off = T.copy()
    off[:3, 3] += [0.01, 0.01, 0.01]
    assert here.residual(there, off) > 3.0 * true
    off[0, 3] += 90.0
    assert np.isnan(here.residual(there, off))


@pytest.mark.parametrize(
    "method", [LocalIcp(), LocalIcp(generalized=True), LocalSmallGicp()], ids=lambda m: m.name
)
@pytest.mark.parametrize("mode", ["keyframe", "frame"])
def test_competitors_follow_a_camera(room: Path, method: object, mode: str) -> None:
    if method.name == "small_gicp":
        pytest.importorskip("small_gicp")
    sequence = read_sequence(room)
    rng = np.random.default_rng(0)
    frames = []
    for number, frame in enumerate(sequence.frames):
        points = sequence.cloud(number)
        kept = rng.choice(len(points), 800, replace=False)
        frames.append(SampledFrame(number, frame.time, points[kept], frame.T_world_camera))
    surfaces = [HeldOutSurface.of(DepthFrames(sequence), k, 0) for k in range(len(frames))]
    told = []
    followed = LocalFollower(method).follow(frames, mode, lambda: told.append(1))
    score = TrajectoryScore.of(followed, frames, surfaces)
    assert len(told) == 8
    assert score.absolute.spread.rmse < 0.03
    assert score.relative[1].rotation_deg.mean < 1.0
    exact = TrajectoryScore.of(as_measured(frames), frames, surfaces)
    assert exact.absolute.spread.largest < 1e-9
    assert exact.residual <= score.residual


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (["--methods", "best"], "methods"),
        (["--modes", "both"], "modes"),
        (["--methods", "ours_adapted"], "adapted"),
        (["--every", "0"], "every, points, pairs"),
        (["--frames", "0-1", "--every", "1", "--methods", "icp"], "frames"),
    ],
)
def test_options_that_cant_be_are_named(room: Path, arguments: list[str], field: str) -> None:
    with pytest.raises(EquivAlignError) as caught:
        benchmark_command(["odometry", "--sequence", str(room), *arguments])
    assert caught.value.field == field
    assert caught.value.mend
