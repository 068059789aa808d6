"""Options that the benchmarks of methods share: who takes part, and where the results go."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from benchmarks.competitor import (
    ORACLE_SUFFIX,
    CandidateOracle,
    Competitor,
    Contestant,
    ExternalPoses,
    Truth,
)
from benchmarks.methods import METHOD_NAMES, OUR_NAMES, build_methods
from benchmarks.plots import write_plots
from benchmarks.result_sheets import result_sheets
from benchmarks.results import Results
from benchmarks.table import print_methods, print_sheets, wide_console
from model.exceptions import InvalidOptionError

DEFAULT_METHODS = "ours,icp,gicp,ransac,fgr"


def add_contest_options(parser: ArgumentParser) -> None:
    """Add --methods, --artifact, --external, --seed and --out."""
    parser.add_argument(
        "--methods",
        type=names,
        default=names(DEFAULT_METHODS),
        metavar="NAMES",
        help=f"of {', '.join(METHOD_NAMES)}; ours_oracle, the best of our candidates by the true "
        f"pose; truth and inverse, to check the scoring; default {DEFAULT_METHODS}",
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
    references, oracles = _references(), _oracles()
    # An oracle chooses among the candidates of a method, whether that takes part or not.
    needed = [oracles.get(name, name) for name in given.methods if name not in references]
    field = build_methods(dict.fromkeys(needed), given.artifact)
    contestants = {method.name: Contestant(method) for method in field.methods}
    known: dict[str, Competitor] = {**references, **contestants}
    known |= {o: CandidateOracle(contestants[n]) for o, n in oracles.items() if n in contestants}
    competitors = [known[name] for name in dict.fromkeys(given.methods) if name in known]
    competitors += [ExternalPoses.read(path) for path in given.external]
    if not competitors:
        raise InvalidOptionError(
            "nobody takes part",
            field="methods",
            mend="name a method whose packages are installed, or give --external",
        )
    return competitors, field.absent


def _references() -> dict[str, Truth]:
    return {truth.name: truth for truth in (Truth(), Truth(inverted=True))}


def _oracles() -> dict[str, str]:
    """The method whose candidates each oracle chooses among."""
    return {name + ORACLE_SUFFIX: name for name in OUR_NAMES}


def finish_contest(results: Results, out: Path | None) -> None:
    """Print the tables; write the plots beside the results."""
    console = wide_console()
    print_sheets(result_sheets(results), console)
    print_methods(results.methods, results.absent, console)
    if out is not None:
        for line in (str(out), *write_plots(results, out)):
            console.print(line, soft_wrap=True, highlight=False)
