from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.command_line import benchmark_command
from benchmarks.growth import resident_bytes
from benchmarks.speed_file import SpeedResults, read_speed


@pytest.fixture(scope="module")
def speed(
    tmp_path_factory: pytest.TempPathFactory, small_artifact: Path
) -> tuple[SpeedResults, str]:
    """One pair by an untrained encoder on few points; and its report."""
    folder = tmp_path_factory.mktemp("speed")
    out = folder / "speed.json"
    argv = ["speed", "--pairs", "1", "--sizes", "1000", "--artifact", str(small_artifact)]
    assert benchmark_command([*argv, "--out", str(out)]) == 0
    assert benchmark_command(["report", str(out), "--out", str(folder / "report.md")]) == 0
    return read_speed(out), (folder / "report.md").read_text()


def test_ours_and_ransac_are_timed_in_the_same_run(speed: tuple[SpeedResults, str]) -> None:
    race = speed[0].sheets[0]
    assert [row[0] for row in race.rows] == ["ours", "ransac"]
    ours, ransac = (float(row[1]) for row in race.rows)
    assert ours > 0.0
    assert float(race.rows[0][5]) == pytest.approx(ours / ransac, rel=0.05, abs=0.01)


def test_stages_add_up_to_the_total(speed: tuple[SpeedResults, str]) -> None:
    stages = {row[0]: float(row[1]) for row in speed[0].sheets[1].rows}
    total = stages.pop("total")
    assert sum(stages.values()) == pytest.approx(total, rel=0.05)


def test_the_gradient_step_stands_beside_the_papers(speed: tuple[SpeedResults, str]) -> None:
    here, there = speed[0].sheets[3].rows
    assert float(here[1]) > 0.0
    assert there[1] == "0.03–0.1"


def test_growth_states_time_and_memory(speed: tuple[SpeedResults, str]) -> None:
    [row] = speed[0].sheets[4].rows
    assert row[0] == "1,000"
    assert float(row[1]) > 0.0
    if resident_bytes("VmHWM") is not None:
        assert 0 <= int(row[3]) < 4096


def test_the_report_shows_every_table(speed: tuple[SpeedResults, str]) -> None:
    results, document = speed
    for sheet in results.sheets:
        assert f"### {sheet.title}" in document
    assert "artifact: untrained, SHA-256" in document
