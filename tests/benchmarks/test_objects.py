from __future__ import annotations

import json
from pathlib import Path

import numpy as np
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
