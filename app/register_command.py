"""``equivalign register``: two files in, the pose out."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from model.cloud_file import read_points, require_known_format, write_points
from model.exceptions import CloudFileError, UnreadableFileError
from model.inner_loop import INNER_LOOPS

if TYPE_CHECKING:
    from model import RegistrationResult

FloatArray = npt.NDArray[np.float64]


def register_command(arguments: list[str]) -> int:
    """Find the pose that moves one cloud onto another."""
    given = _parser().parse_args(arguments)
    _check_destinations(given)
    source, target = read_points(given.source, "source"), read_points(given.target, "target")
    result = _register(given, source, target)
    if given.out is not None:
        write_points(given.out, result.transform(source))
    if given.report is not None:
        _write_report(given, source, target, result)
    _print_answer(result, as_json=given.json)
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="equivalign register",
        description="Find T_target_source, the pose that moves the source cloud onto the target. "
        "Clouds are PLY, PCD, XYZ, NPY or NPZ files in any unit, the same for both.",
    )
    parser.add_argument("source", type=Path, metavar="SOURCE", help="the cloud that is moved")
    parser.add_argument("target", type=Path, metavar="TARGET", help="the cloud that stays")
    parser.add_argument("--artifact", metavar="DIR", help="trained artifact")
    parser.add_argument(
        "--initial", type=Path, metavar="FILE", help="guess of the pose, 4×4, .txt or .npy"
    )
    parser.add_argument(
        "--max-rotation-deg", type=float, default=180.0, metavar="DEG", help="default 180"
    )
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument("--solver", choices=list(INNER_LOOPS), help="default: the artifact's")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the moved source here")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write an HTML page here")
    parser.add_argument("--json", action="store_true", help="print what POST /register answers")
    return parser


def _check_destinations(given: Namespace) -> None:
    """Refuse before the long part what could not be written after it."""
    if given.out is not None:
        require_known_format(given.out, "out")
    for field in ("out", "report"):
        path: Path | None = getattr(given, field)
        if path is not None and not path.parent.is_dir():
            raise CloudFileError(
                "its folder doesn't exist", field=field, value=path, mend="create the folder first"
            )


def _register(given: Namespace, source: FloatArray, target: FloatArray) -> RegistrationResult:
    from model import Registrar

    initial = None if given.initial is None else _read_pose(given.initial)
    return Registrar.load(given.artifact).register(
        source,
        target,
        initial=initial,
        max_rotation_deg=given.max_rotation_deg,
        seed=given.seed,
        solver=given.solver,
    )


def _read_pose(path: Path) -> FloatArray:
    """Read a matrix of numbers; the registrar judges whether it's a pose."""
    try:
        if path.suffix.lower() == ".npy":
            return np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
        lines = path.read_text().splitlines()
        return np.array([line.split() for line in lines if line.strip()], dtype=np.float64)
    except (OSError, ValueError, EOFError) as error:
        raise UnreadableFileError(
            "the pose can't be read",
            field="initial",
            value=path,
            mend="give four rows of four numbers as .txt, or a (4, 4) array as .npy",
        ) from error


def _write_report(
    given: Namespace, source: FloatArray, target: FloatArray, result: RegistrationResult
) -> None:
    from app.report import write_report

    title = f"{given.source.name} onto {given.target.name}"
    write_report(given.report, title, source, target, result)


def _print_answer(result: RegistrationResult, *, as_json: bool) -> None:
    if as_json:
        from app.schemas import RegisterResponse

        print(json.dumps(RegisterResponse.of(result).document(), allow_nan=False))
    else:
        _print_in_words(result)


def _print_in_words(result: RegistrationResult) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from app.findings import findings, pose_lines

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for subject, statement in pose_lines(result) + findings(result.diagnostics):
        style = "yellow" if subject == "Warning" else None
        table.add_row(subject, Text(statement), style=style)
    Console(highlight=False).print(table)
