"""A tiny version of docs/results.md, made by the commands that make the real one."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from benchmarks.command_line import benchmark_command
from benchmarks.document import read_document
from benchmarks.markdown import markdown
from benchmarks.printed import printed_methods, printed_rotation
from benchmarks.readme import BEGIN, END, readme_table, with_table
from benchmarks.report import document_text
from benchmarks.sheet import Sheet
from model.exceptions import InvalidOptionError, UnreadableFileError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two pairs, and the report of them."""
    folder = tmp_path_factory.mktemp("report")
    (folder / "README.md").write_text(f"# A\n\n{BEGIN}\nSTALE\n{END}\n\nlast\n")
    run = [
        *("objects", "--protocol", "paper", "--columns", "clean,crop20", "--angles", "45"),
        *("--limit", "1", "--methods", "identity,ransac,icp", "--out", str(folder / "o.json")),
    ]
    assert benchmark_command(run) == 0
    report = ["report", str(folder / "o.json"), "--out", str(folder / "results.md")]
    assert benchmark_command([*report, "--readme", str(folder / "README.md")]) == 0
    return folder


@pytest.fixture
def document(folder: Path) -> str:
    return (folder / "results.md").read_text()


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
    assert len(found) == 3
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


def test_the_second_overview_shows_successes(document: str) -> None:
    successes = tables(document)[1]
    assert "| identity | 0 % | 0 % |" in successes
    assert "| ransac | 100 % | 100 % |" in successes


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


def test_a_report_never_takes_the_place_of_results(folder: Path) -> None:
    before = (folder / "o.json").read_text()
    with pytest.raises(InvalidOptionError, match="overwrite results"):
        benchmark_command(["report", str(folder / "o.json"), "--out", str(folder / "o.md")])
    assert (folder / "o.json").read_text() == before


def test_the_collection_gives_the_same_document(folder: Path, document: str) -> None:
    collected = read_document(folder / "results.json")
    assert document_text(collected) == document
    again = folder / "again.md"
    assert benchmark_command(["report", str(folder / "results.json"), "--out", str(again)]) == 0
    assert tables(again.read_text()) == tables(document)


def test_the_readme_gets_the_headlines_and_keeps_the_rest(folder: Path) -> None:
    readme = (folder / "README.md").read_text()
    assert readme.startswith("# A\n")
    assert readme.endswith("\n\nlast\n")
    assert "STALE" not in readme
    [table] = tables(readme)
    assert table[0] == "| pairs | figure | FPFH + RANSAC + ICP | ICP | the paper (printed) |"
    clean = next(line for line in table if "procedural, paper, 45°, clean, 1 pairs" in line)
    assert "| mean rotation error, ° | **0.00** |" in clean
    assert clean.endswith("| 0.61 |")
    assert "Measured 20" in readme


def test_a_readme_without_a_place_for_the_table_is_refused(folder: Path) -> None:
    for text in ("# A\n", f"{END}{BEGIN}", f"{BEGIN}{END}{BEGIN}{END}"):
        with pytest.raises(UnreadableFileError, match="no place"):
            with_table(text, "t", folder / "README.md")


def test_the_documents_in_the_repository_are_those_that_were_generated() -> None:
    collected = read_document(ROOT / "docs" / "results.json")
    assert (ROOT / "docs" / "results.md").read_text("utf-8") == document_text(collected)
    readme = (ROOT / "README.md").read_text("utf-8")
    assert with_table(readme, readme_table(collected), ROOT / "README.md") == readme


def documented_commands() -> list[list[str]]:
    """The words after ``python -m benchmarks`` of every command in docs/benchmarks.md."""
    text = (ROOT / "docs" / "benchmarks.md").read_text("utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    commands = [shlex.split(line, comments=True) for line in lines]
    return [words[3:] for words in commands if words[:3] == ["python", "-m", "benchmarks"]]


@pytest.mark.parametrize("words", documented_commands(), ids=" ".join)
def test_documented_commands_have_the_options_they_use(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        benchmark_command([words[0], "--help"])
    assert end.value.code == 0
    helped = capsys.readouterr().out
    assert [word for word in words if word.startswith("--") and word not in helped] == []


def test_the_papers_three_experiments_are_documented() -> None:
    names = [words[0] for words in documented_commands()]
    assert {"objects", "rgbd", "ablations"} <= set(names)
