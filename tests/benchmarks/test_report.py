"""A tiny version of docs/results.md, made by the commands that make the real one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.command_line import benchmark_command
from benchmarks.printed import printed_methods, printed_rotation
from benchmarks.report import markdown
from benchmarks.sheet import Sheet
from model.exceptions import UnreadableFileError


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    results, out = folder / "objects.json", folder / "results.md"
    run = [
        *("objects", "--protocol", "paper", "--columns", "clean,crop20", "--angles", "45"),
        *("--limit", "1", "--methods", "identity,ransac", "--out", str(results)),
    ]
    assert benchmark_command(run) == 0
    assert benchmark_command(["report", str(results), "--out", str(out)]) == 0
    return out.read_text()


def tables(text: str) -> list[list[str]]:
    """Runs of lines that begin with a bar."""
    blocks = re.findall(r"(?:^\|.*\n?)+", text, flags=re.MULTILINE)
    return [block.strip().splitlines() for block in blocks]


def test_the_document_says_where_its_figures_come_from(document: str) -> None:
    assert document.startswith("# Results\n")
    assert "`python -m benchmarks report" in document
    assert "`python -m benchmarks objects --protocol paper" in document
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC; .+, \d+ cores, \d+ threads", document)
    assert re.search(r"commit \S+;", document)
    assert "with_scaling False" in document


def test_every_table_is_well_formed(document: str) -> None:
    found = tables(document)
    assert len(found) == 2
    for lines in found:
        assert len({line.count("|") for line in lines}) == 1
        assert re.fullmatch(r"\|( :?-+:? \|)+", lines[1])
        assert len(lines) > 2


def test_the_overview_shows_the_printed_figures_as_printed(document: str) -> None:
    overview = tables(document)[0]
    assert overview[0] == "| method | 45° clean | 45° crop20 |"
    assert "| identity | 45.00 | 45.00 |" in overview
    assert "| EquivAlign (printed) | 0.61 | 19.20 |" in overview
    assert "| GeoTransformer (printed) | 0.67 | 1.39 |" in overview


def test_printed_figures_are_the_papers() -> None:
    assert printed_rotation("E2PN", "90", "outliers") == 70.61
    assert printed_rotation("Geometric-CVO", "90", "crop20") == 52.47
    assert printed_rotation("ICP", "so3", "clean") is None
    for method in printed_methods():
        assert printed_rotation(method, "90", "crop20") is not None


def test_bars_in_a_text_do_not_break_a_table() -> None:
    text = markdown(Sheet("t", ["a", "b"], [["x|y", "1"]], note="n"))
    assert text == "### t\n\n| a | b |\n| :-- | --: |\n| x\\|y | 1 |\n\nn\n"


def test_other_files_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text('{"format_version": 7}')
    with pytest.raises(UnreadableFileError, match="results"):
        benchmark_command(["report", str(other), "--out", str(tmp_path / "x.md")])
