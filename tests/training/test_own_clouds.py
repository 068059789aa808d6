from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_run import CONFIGS, QUIET, run_in_another_process, small

from model.cloud_file import write_points
from training.checkpoint import latest_checkpoint
from training.cli import fit
from training.data.procedural import ProceduralShapes


@pytest.fixture
def scans(tmp_path: Path, shapes: ProceduralShapes) -> Path:
    """Fifty unlabelled clouds, in millimetres and far from the origin."""
    folder = tmp_path / "scans"
    folder.mkdir()
    for number in range(50):
        points = 300.0 * shapes[number].points.double().numpy() + [1e5, 2e5, 50.0]
        write_points(folder / f"scan_{number:02}.ply", points)
    return folder


def arguments(folder: Path, root: Path) -> list[str]:
    return [
        *small(CONFIGS / "own_clouds.yaml"),
        *("--data.path", str(folder), "--trainer.default_root_dir", str(root)),
        *("--trainer.max_steps", "2", "--trainer.val_check_interval", "2"),
        *("--data.evaluation_pairs", "4"),
    ]


@QUIET
def test_a_folder_of_clouds_trains_with_one_command(scans: Path, tmp_path: Path):
    assert fit(arguments(scans, tmp_path)) == 0
    assert latest_checkpoint(tmp_path) is not None


@QUIET
def test_bad_files_are_listed_counted_and_skipped(scans: Path, tmp_path: Path):
    (scans / "scan_07.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 900\n")
    write_points(scans / "scan_08.ply", np.linspace(0.0, 1.0, 2000)[:, None] * np.ones(3))
    write_points(scans / "scan_09.ply", np.full((2000, 3), 3.0))
    (scans / "scan_10.ply").write_bytes(b"")
    with pytest.warns(UserWarning, match="4 of 50 files can't be used") as caught:
        assert fit(arguments(scans, tmp_path)) == 0
    text = next(str(one.message) for one in caught if "can't be used" in str(one.message))
    assert all(f"scan_{number}.ply: " in text for number in ("07", "08", "09", "10"))


def test_nothing_left_is_refused_in_one_line(tmp_path: Path):
    folder = tmp_path / "scans"
    folder.mkdir()
    for number in range(3):
        (folder / f"{number}.ply").write_bytes(b"not a cloud")
    answer = run_in_another_process("fit", *arguments(folder, tmp_path / "runs"))
    assert answer.returncode == 2
    assert "Traceback" not in answer.stderr
    assert "none of 3 files can be used" in answer.stderr.splitlines()[-1]
    assert latest_checkpoint(tmp_path) is None
