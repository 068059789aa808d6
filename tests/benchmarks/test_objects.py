from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import open3d
import pytest

from benchmarks.command_line import benchmark_command
from benchmarks.results import Results, read_results
from benchmarks.summary import Summary, cells, rows_by_method
from model.exceptions import InvalidOptionError, UnreadableFileError

TINY = [
    "objects",
    *("--protocol", "paper", "--columns", "clean", "--angles", "45"),
    *("--limit", "2", "--seed", "3"),
]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two pairs by the identity."""
    out = tmp_path_factory.mktemp("objects") / "results.json"
    assert benchmark_command([*TINY, "--methods", "identity", "--out", str(out)]) == 0
    return out


def test_results_state_where_they_come_from(first: Path) -> None:
    results = read_results(first)
    assert len(results.pairs) == len(results.rows) == 2
    assert results.runs[0].command.startswith("python -m benchmarks objects")
    assert results.runs[0].cores >= 1
    assert all(pair.initial_deg == pytest.approx(45.0, abs=1e-4) for pair in results.pairs.values())
    [cell] = cells(results)
    summary = Summary.of(rows_by_method(results, cell)["identity"])
    assert summary.rotation_mean == pytest.approx(45.0, abs=1e-4)
    assert summary.below_5 == summary.adds_success == 0.0


def test_the_page_of_plots_needs_no_network(first: Path) -> None:
    page = first.with_suffix(".html").read_text()
    assert "share of pairs below an error" in page
    assert "<script src=" not in page


def test_a_run_goes_on_where_it_stopped(first: Path) -> None:
    before = read_results(first)
    argv = [*TINY, "--methods", "identity,ransac", "--out", str(first)]
    assert benchmark_command(argv) == 0
    after = read_results(first)
    assert len(after.rows) == 4
    assert {key: row for key, row in after.rows.items() if key[1] == "identity"} == before.rows
    assert after.rows[next(iter(after.pairs)), "ransac"].run == 1
    content = first.read_text()
    assert benchmark_command(argv) == 0
    assert json.loads(first.read_text())["rows"] == json.loads(content)["rows"]
    assert len(read_results(first).runs) == 2


def test_results_of_other_settings_are_not_mixed(first: Path) -> None:
    with pytest.raises(InvalidOptionError, match="other settings"):
        benchmark_command([*TINY, "--sampler", "official", "--out", str(first)])


def test_rows_of_one_method_with_other_settings_are_not_mixed() -> None:
    results = Results("objects", {})
    results.admit("ours", {"solver": "procrustes", "weights_sha256": "a"})
    results.admit("ours", {"solver": "procrustes", "weights_sha256": "a"})
    with pytest.raises(InvalidOptionError, match=r"weights_sha256 a\)"):
        results.admit("ours", {"solver": "procrustes", "weights_sha256": "b"})


def test_poses_of_another_program_are_scored(first: Path, tmp_path: Path) -> None:
    results = read_results(first)
    poses = {name: np.eye(4).tolist() for name in results.pairs}
    external = tmp_path / "poses.json"
    external.write_text(json.dumps({"name": "stranger", "poses": poses}))
    argv = [*TINY, "--methods", "", "--external", str(external), "--out", str(first)]
    assert benchmark_command(argv) == 0
    scored = read_results(first)
    for name in poses:
        stranger, identity = scored.rows[name, "stranger"], scored.rows[name, "identity"]
        assert stranger.error == identity.error
        assert stranger.seconds is None


def test_a_missing_external_pose_is_an_error(tmp_path: Path) -> None:
    external = tmp_path / "poses.json"
    external.write_text(json.dumps({"name": "stranger", "poses": {}}))
    with pytest.raises(InvalidOptionError, match="no pose for this pair"):
        benchmark_command([*TINY, "--methods", "", "--external", str(external)])
    external.write_text('{"poses": {"a": [[1, 2], [3, 4]]}}')
    with pytest.raises(UnreadableFileError, match="external"):
        benchmark_command([*TINY, "--methods", "", "--external", str(external)])


def test_pairs_are_exported_without_their_poses(tmp_path: Path) -> None:
    out = tmp_path / "results.json"
    argv = [*TINY, "--methods", "identity", "--export-pairs", str(tmp_path), "--out", str(out)]
    assert benchmark_command(argv) == 0
    for name, pair in read_results(out).pairs.items():
        with np.load(tmp_path / f"{name}.npz") as archive:
            assert set(archive.files) == {"source", "target", "seed"}
            assert archive["source"].shape == (pair.points_source, 3)


def test_results_in_a_folder_that_is_not_there_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="folder doesn't exist"):
        benchmark_command(
            [*TINY, "--methods", "identity", "--out", str(tmp_path / "no" / "r.json")]
        )


def test_wrong_options_are_refused() -> None:
    with pytest.raises(InvalidOptionError, match="methods"):
        benchmark_command([*TINY, "--methods", "telepathy"])
    with pytest.raises(InvalidOptionError, match="nobody takes part"):
        benchmark_command([*TINY, "--methods", ""])
    with pytest.raises(InvalidOptionError, match="endless"):
        benchmark_command(["objects", "--limit", "0"])
    assert benchmark_command(["nonsense"]) == 2
    assert benchmark_command([]) == 0


def modelnet(root: Path) -> Path:
    """Meshes of a bent bar and of a ball, in the layout of ModelNet40."""
    for category, mesh in (("bar", bent_bar()), ("ball", ball())):
        for split in ("train", "test"):
            (root / category / split).mkdir(parents=True)
            path = str(root / category / split / f"{category}_0001.off")
            assert open3d.io.write_triangle_mesh(path, mesh)
    return root


def bent_bar() -> Any:
    """Three boxes along three axes."""
    box = open3d.geometry.TriangleMesh.create_box
    upright = box(0.1, 0.1, 0.6).translate([0.9, 0.0, 0.0])
    return box(1.0, 0.2, 0.1) + box(0.15, 0.9, 0.1) + upright


def ball() -> Any:
    return open3d.geometry.TriangleMesh.create_sphere(0.5)


def test_symmetric_shapes_of_modelnet_have_a_table_of_their_own(tmp_path: Path) -> None:
    root, out = modelnet(tmp_path / "ModelNet40"), tmp_path / "results.json"
    argv = [
        *("objects", "--data", str(root), "--protocol", "hard", "--columns", "resampled"),
        *("--limit", "0", "--symmetric", "5", "--methods", "identity", "--out", str(out)),
    ]
    assert benchmark_command(argv) == 0
    results = read_results(out)
    groups = {pair.entry.group: pair.entry.subject_name for pair in results.pairs.values()}
    assert set(groups) == {"asymmetric", "symmetric"}
    assert "bar" in groups["asymmetric"]
    assert "ball" in groups["symmetric"]
    assert [cell.group for cell in cells(results)] == ["asymmetric", "symmetric"]
    ball_rows = rows_by_method(results, cells(results)[1])["identity"]
    assert ball_rows[0].error.rotation_deg > 5.0


def test_an_oracle_and_the_references_can_be_named(tmp_path: Path, small_artifact: Path) -> None:
    out = tmp_path / "results.json"
    named = "ours,ours_oracle,truth,inverse"
    argv = [*TINY, "--limit", "1", "--methods", named, "--artifact", str(small_artifact)]
    assert benchmark_command([*argv, "--out", str(out)]) == 0
    results = read_results(out)
    assert list(results.methods) == named.split(",")
    [pair] = results.pairs
    assert results.rows[pair, "truth"].error.rotation_deg == pytest.approx(0.0, abs=1e-6)
    assert results.rows[pair, "inverse"].error.rotation_deg == pytest.approx(90.0, abs=1e-4)
    ours, best = results.rows[pair, "ours"], results.rows[pair, "ours_oracle"]
    assert best.error.rank <= ours.error.rank
    assert best.findings["candidates"] >= 1
    assert ours.seconds is not None
    assert best.seconds is None
