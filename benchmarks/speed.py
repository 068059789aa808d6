"""``speed``: ours against FPFH + RANSAC + ICP, our stages, growth and gradient steps."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from rich.progress import Progress

from benchmarks.contest import contest_progress
from benchmarks.global_speed import GlobalRace, RacePairs
from benchmarks.gradient_speed import gradient_sheet
from benchmarks.growth import growth_sheet
from benchmarks.methods.equivalign import EquivAlign
from benchmarks.methods.fpfh import FpfhRansac
from benchmarks.provenance import Provenance
from benchmarks.results import require_folder
from benchmarks.sheet import Sheet
from benchmarks.speed_file import SpeedResults
from benchmarks.table import print_methods, print_sheets, wide_console
from model import Registrar
from model.artifact import load_artifact

SIZES = [1_000, 10_000, 100_000, 1_000_000]


def speed_command(arguments: list[str], command: str) -> int:
    """Measure time and memory; every comparison is within this one run.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = _parser().parse_args(arguments)
    if given.out is not None:
        require_folder(given.out)
    provenance = Provenance.now(command)
    artifact = load_artifact(given.artifact)
    ours = EquivAlign("ours", Registrar(artifact))
    ransac = FpfhRansac()
    with contest_progress() as progress:
        race = GlobalRace.run(ours, ransac, RacePairs(given.pairs, given.seed), progress)
        sheets = [
            race.global_sheet(),
            race.stage_sheet(),
            race.local_sheet(),
            gradient_sheet(artifact, given.seed),
            *_growth(given.sizes, given.artifact, given.seed, progress),
        ]
    results = SpeedResults(
        {"pairs": given.pairs, "sizes": given.sizes, "seed": given.seed},
        [provenance],
        {ours.name: ours.settings, ransac.name: ransac.settings},
        sheets,
    )
    console = wide_console()
    print_sheets(sheets, console)
    print_methods(results.methods, [], console)
    if given.out is not None:
        results.write(given.out)
        console.print(str(given.out))
    return 0


def _growth(sizes: list[int], artifact: str | None, seed: int, progress: Progress) -> list[Sheet]:
    return [growth_sheet(sizes, artifact, seed, progress)] if sizes else []


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign benchmark speed", description=__doc__)
    parser.add_argument("--pairs", type=int, default=20, metavar="N", help="default 20")
    parser.add_argument(
        "--sizes",
        type=_sizes,
        default=SIZES,
        metavar="N,…",
        help="points a cloud; default 1000,10000,100000,1000000; none leaves growth out",
    )
    parser.add_argument("--artifact", metavar="DIR", help="ours; default: the shipped one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, metavar="FILE", help="results as JSON")
    return parser


def _sizes(text: str) -> list[int]:
    return [] if text == "none" else [int(size) for size in text.split(",")]
