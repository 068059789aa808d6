"""``equivalign COMMAND …``: finds the commands that the installed packages offer."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import EntryPoint, entry_points, requires, version

DISTRIBUTION = "equivalign"
COMMANDS = "equivalign.commands"

_REFUSED = 2
_INTERRUPTED = 130

Command = Callable[[list[str]], int]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the command's name and its arguments; by default the process's.

    Returns:
        The exit code: 0 when all went well, 2 for anything that the caller can mend.
    """
    name, *arguments = [*(sys.argv[1:] if argv is None else argv)] or ["--help"]
    if name in ("-h", "--help"):
        sys.stdout.write(_overview())
        return 0
    if name == "--version":
        sys.stdout.write(f"{DISTRIBUTION} {version(DISTRIBUTION)}\n")
        return 0
    commands = _commands()
    if name not in commands:
        return _refuse(f"unknown command {name!r}; there are {', '.join(commands)}")
    return _run(commands[name], arguments)


def _commands() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=COMMANDS)}


def _overview() -> str:
    commands = _commands()
    width = max(map(len, commands), default=0)
    lines = [f"  {name:<{width}}  {_summary(point)}" for name, point in commands.items()]
    return "\n".join(
        [
            "usage: equivalign COMMAND [ARGUMENTS …]",
            "",
            "Correspondence-free registration of point clouds.",
            "",
            *lines,
            "",
            "equivalign COMMAND --help tells more; equivalign --version tells the version.",
            "",
        ]
    )


def _summary(point: EntryPoint) -> str:
    """The first line of the command's docstring, or what it misses."""
    try:
        return (point.load().__doc__ or "").strip().partition("\n")[0]
    except ModuleNotFoundError as error:
        return f"({_missing(error)})"


def _run(point: EntryPoint, arguments: list[str]) -> int:
    from model.exceptions import EquivAlignError

    try:
        command: Command = point.load()
        return command(arguments)
    except EquivAlignError as error:
        return _refuse(str(error))
    except ModuleNotFoundError as error:
        if _extra_of(error.name) is None:
            raise
        return _refuse(_missing(error))
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else _REFUSED
    except KeyboardInterrupt:
        return _INTERRUPTED


def _refuse(problem: str) -> int:
    sys.stderr.write(f"equivalign: {' '.join(problem.split())}\n")
    return _REFUSED


def _missing(error: ModuleNotFoundError) -> str:
    extra = _extra_of(error.name)
    if extra is None:
        return f"not available: no module named {error.name!r}"
    return f"needs more packages: pip install '{DISTRIBUTION}[{extra}]'"


def _extra_of(module: str | None) -> str | None:
    """The extra of this distribution that brings a module, if one does."""
    package = (module or "").partition(".")[0].replace("_", "-").lower()
    for requirement in requires(DISTRIBUTION) or []:
        found = re.match(r"([\w.-]+).*extra == ['\"]([\w-]+)['\"]", requirement)
        if found and found[1].replace("_", "-").lower() == package:
            return found[2]
    return None
