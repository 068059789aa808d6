from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.calibration import Calibration, with_probability
from benchmarks.pair import BenchmarkPair
from benchmarks.plots import result_plots, write_plots
from benchmarks.pose_error import PoseError
from benchmarks.result_sheets import result_sheets
from benchmarks.results import Results, Row
from model.exceptions import UnreadableFileError


def results(pairs: list[BenchmarkPair], *stated: float, right: int | None = None) -> Results:
    """Answers of one method: the first ``right`` of them true, the others not moved at all."""
    filled = Results("objects", {})
    filled.admit("ours", {})
    for number, pair in enumerate(pairs):
        filled.list_pair(pair)
        T = pair.T_target_source if right is None or number < right else np.eye(4)
        findings = {"success_probability": stated[number]} if stated else {}
        error = PoseError.of(T, pair)
        filled.add(Row(pair.entry.name, "ours", 0, error, 0.1, T.tolist(), findings))
    return filled


def test_reliability_is_drawn_only_for_methods_that_state_a_probability(
    pairs: list[BenchmarkPair],
) -> None:
    silent = result_plots(results(pairs))
    assert not [plot for plot in silent if plot.name.startswith("reliability")]
    stating = result_plots(results(pairs, *[0.9] * len(pairs)))
    [plot] = [plot for plot in stating if plot.name.startswith("reliability")]
    measured, calibrated = plot.series
    assert measured.name.startswith(f"ours, {len(pairs)} pairs")
    assert list(measured.y) == [1.0]
    assert list(calibrated.x) == list(calibrated.y)


def test_there_is_a_plot_a_column_and_one_a_cell(pairs: list[BenchmarkPair]) -> None:
    names = [plot.name for plot in result_plots(results(pairs))]
    for column in {pair.entry.column for pair in pairs}:
        assert f"error_by_angle_asymmetric_{column}" in names
        assert f"cumulative_asymmetric_45_{column}" in names
    assert len(names) == len(set(names))


def test_the_share_below_an_error_reaches_all_pairs(pairs: list[BenchmarkPair]) -> None:
    drawn = result_plots(results(pairs, right=1))
    [plot] = [plot for plot in drawn if plot.name == "cumulative_asymmetric_45_clean"]
    [series] = plot.series
    assert list(series.y) == [0.5, 1.0]
    assert series.x[-1] == pytest.approx(45.0, abs=1e-4)


def test_plots_are_written_as_images_and_as_one_page(
    pairs: list[BenchmarkPair], tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    filled = results(pairs)
    said = write_plots(filled, tmp_path / "r.json")
    images = sorted((tmp_path / "r").glob("*.png"))
    assert len(images) == len(result_plots(filled))
    assert all(image.read_bytes().startswith(b"\x89PNG") for image in images)
    assert "<script src=" not in (tmp_path / "r.html").read_text()
    assert said == [str(tmp_path / "r.html"), f"{tmp_path / 'r'}/: {len(images)} PNG plots"]


def test_without_matplotlib_it_says_that_there_are_no_images(
    pairs: list[BenchmarkPair], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    said = write_plots(results(pairs), tmp_path / "r.json")
    assert (tmp_path / "r.html").is_file()
    assert "isn't installed" in said[1]
    assert not (tmp_path / "r").exists()


def test_a_file_in_the_place_of_the_images_is_refused(
    pairs: list[BenchmarkPair], tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    (tmp_path / "r").write_text("mine")
    with pytest.raises(UnreadableFileError, match="folder can't be made"):
        write_plots(results(pairs), tmp_path / "r.json")
    assert (tmp_path / "r").read_text() == "mine"


def test_calibration_tells_bold_from_honest(pairs: list[BenchmarkPair]) -> None:
    honest = Calibration.of(results(pairs, 0.95, 0.95, 0.05, 0.05, right=2), "ours")
    assert honest.expected_error == pytest.approx(0.05)
    assert honest.brier == pytest.approx(0.0025)
    assert honest.ranking == 1.0
    bold = Calibration.of(results(pairs, 0.95, 0.95, 0.95, 0.95, right=2), "ours")
    assert bold.expected_error == pytest.approx(0.45)
    assert bold.ranking == 0.5
    assert bold.bins() == [(pytest.approx(0.95), 0.5, 4)]
    assert with_probability(results(pairs)) == []


def test_the_tables_say_whether_probabilities_hold(pairs: list[BenchmarkPair]) -> None:
    assert "success probability" not in [s.title for s in result_sheets(results(pairs))]
    sheets = result_sheets(results(pairs, 0.9, 0.8, 0.3, 0.2, right=2))
    [sheet] = [sheet for sheet in sheets if sheet.title == "success probability"]
    assert sheet.rows == [["ours", "4", "55 %", "50 %", "0.200", "0.045", "1.000"]]
