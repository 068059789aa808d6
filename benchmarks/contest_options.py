"""Options that the benchmarks of methods share: who takes part, and where the results go."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from rich.console import Console

from benchmarks.competitor import Competitor, Contestant, ExternalPoses
from benchmarks.methods import METHOD_NAMES, build_methods
from benchmarks.plots import write_plots
from benchmarks.result_sheets import result_sheets
from benchmarks.results import Results
from benchmarks.table import print_methods, print_sheets
from model.exceptions import InvalidOptionError

DEFAULT_METHODS = "ours,icp,gicp,ransac,fgr"


def add_contest_options(parser: ArgumentParser) -> None:
    """Add --methods, --artifact, --external, --seed and --out."""
    parser.add_argument(
        "--methods",
        type=names,
        default=names(DEFAULT_METHODS),
        metavar="NAMES",
        help=f"of {', '.join(METHOD_NAMES)}; default {DEFAULT_METHODS}",
    )
    parser.add_argument("--artifact", metavar="DIR", help="ours; default: the shipped one")
    parser.add_argument(
        "--external",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="poses another program found; may be given more than once",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="results as JSON, plots beside it; resumes"
    )


def names(text: str) -> list[str]:
    """Names with commas between."""
    return [name.strip() for name in text.split(",") if name.strip()]


def competitors_of(given: Namespace) -> tuple[list[Competitor], list[str]]:
    """Who takes part, and why the others can't.

    Raises:
        InvalidOptionError: nobody takes part, or a method that isn't known.
        CloudFileError: a file of poses can't be read.
    """
    field = build_methods(given.methods, given.artifact)
    competitors: list[Competitor] = [Contestant(method) for method in field.methods]
    competitors += [ExternalPoses.read(path) for path in given.external]
    if not competitors:
        raise InvalidOptionError(
            "nobody takes part",
            field="methods",
            mend="name a method whose packages are installed, or give --external",
        )
    return competitors, field.absent


def finish_contest(results: Results, out: Path | None) -> None:
    """Print the tables; write the plots beside the results."""
    console = Console()
    print_sheets(result_sheets(results), console)
    print_methods(results.methods, results.absent, console)
    if out is not None:
        for line in (str(out), *write_plots(results, out)):
            console.print(line, soft_wrap=True, highlight=False)
