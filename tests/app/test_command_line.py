"""``equivalign``: finding and running commands, exit codes, one-line errors."""

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from app import command_line
from app.command_line import COMMANDS, main
from model.exceptions import InvalidOptionError


def offer(monkeypatch: pytest.MonkeyPatch, folder: Path, source: str) -> None:
    """Make ``equivalign try`` run the function ``command`` of a module with this source."""
    (folder / "offered_command.py").write_text(source)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "offered_command", raising=False)
    point = EntryPoint("try", "offered_command:command", COMMANDS)
    monkeypatch.setattr(command_line, "entry_points", lambda group: [point])


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_the_overview_lists_every_command(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 0
    listed = capsys.readouterr().out
    for name, summary in {
        "register": "Find the pose that moves one cloud onto another.",
        "serve": "Answer registrations over HTTP",
    }.items():
        assert any(name in line and summary in line for line in listed.splitlines())
    assert "fit" in listed


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("equivalign ")


def test_an_unknown_command_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reigster"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "reigster" in error
    assert "register" in error


def test_arguments_and_exit_code_are_passed_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    offer(monkeypatch, tmp_path, "def command(arguments):\n    return len(arguments)\n")
    assert main(["try", "a", "--b", "c"]) == 3


def test_a_command_without_its_packages_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    offer(monkeypatch, tmp_path, "import lightning\n")
    monkeypatch.setitem(sys.modules, "lightning", None)
    assert main(["--help"]) == 0
    assert "pip install 'equivalign[train]'" in capsys.readouterr().out
    assert main(["try"]) == 2
    assert capsys.readouterr().err == (
        "equivalign: needs more packages: pip install 'equivalign[train]'\n"
    )


def test_an_error_of_the_project_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command(arguments: list[str]) -> int:
        raise InvalidOptionError("two\nlines", field="seed", value=-1, mend="give another")

    monkeypatch.setattr("app.register_command.register_command", command)
    assert main(["register"]) == 2
    assert capsys.readouterr().err == "equivalign: seed: two lines (got -1); give another\n"


@pytest.mark.parametrize(
    ("raised", "code"),
    [("KeyboardInterrupt", 130), ("SystemExit(3)", 3), ("SystemExit('no')", 2)],
)
def test_exit_codes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, raised: str, code: int
) -> None:
    offer(monkeypatch, tmp_path, f"def command(arguments):\n    raise {raised}\n")
    assert main(["try"]) == code
