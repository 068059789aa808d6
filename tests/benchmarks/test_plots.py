from __future__ import annotations

from pathlib import Path

from benchmarks.pair import BenchmarkPair
from benchmarks.plots import write_plots
from benchmarks.pose_error import PoseError
from benchmarks.results import Results, Row


def results(pairs: list[BenchmarkPair], findings: dict[str, float]) -> Results:
    filled = Results("objects", {})
    filled.admit("ours", {})
    for pair in pairs:
        filled.list_pair(pair)
        T = pair.T_target_source
        error = PoseError.of(T, pair)
        filled.add(Row(pair.entry.name, "ours", 0, error, 0.1, T.tolist(), dict(findings)))
    return filled


def test_reliability_is_drawn_only_for_methods_that_state_a_probability(
    pairs: list[BenchmarkPair], tmp_path: Path
) -> None:
    page = tmp_path / "plots.html"
    write_plots(results(pairs, {}), page)
    assert "reliability" not in page.read_text()
    write_plots(results(pairs, {"success_probability": 0.9}), page)
    text = page.read_text()
    assert "ours: reliability of the success probability" in text
    assert f"{len(pairs)} pairs" in text


def test_there_are_two_plots_a_cell(pairs: list[BenchmarkPair], tmp_path: Path) -> None:
    page = tmp_path / "plots.html"
    write_plots(results(pairs, {}), page)
    text = page.read_text()
    for column in {pair.entry.column for pair in pairs}:
        assert f"{column}: error by initial angle" in text
        assert f"{column}: share of pairs below an error" in text
