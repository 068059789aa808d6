"""``service``: what HTTP adds, the service under load, and a stop in mid-load."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from rich.console import Console

from benchmarks.provenance import Provenance
from benchmarks.results import require_folder
from benchmarks.service_load import load_sheet, stop_sheet
from benchmarks.service_overhead import overhead_sheet
from benchmarks.service_process import service_process
from benchmarks.service_request import service_pairs
from benchmarks.speed_file import SpeedResults
from benchmarks.table import print_sheets

_PAIRS = 8
_STOP_AFTER_SECONDS = 8.0


def service_command(arguments: list[str], command: str) -> int:
    """Run the service as a process of its own and call it over HTTP.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = _parser().parse_args(arguments)
    if given.out is not None:
        require_folder(given.out)
    provenance = Provenance.now(command)
    pairs = service_pairs(_PAIRS, given.seed)
    with service_process(given.artifact, deadline=given.deadline) as service:
        sheets = [
            overhead_sheet(service, pairs, given.rounds),
            load_sheet(service, pairs, given.callers, given.seconds, given.deadline),
        ]
    with service_process(given.artifact, deadline=given.deadline) as service:
        sheets.append(stop_sheet(service, pairs, given.callers, _STOP_AFTER_SECONDS))
    settings = {name: value for name, value in vars(given).items() if name != "out"}
    results = SpeedResults(settings, [provenance], {}, sheets)
    console = Console()
    print_sheets(sheets, console)
    if given.out is not None:
        results.write(given.out)
        console.print(str(given.out))
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign benchmark service", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="of 8 pairs; default 3")
    parser.add_argument("--callers", type=int, default=16, metavar="N", help="default 16")
    parser.add_argument("--seconds", type=float, default=60.0, help="of load; default 60")
    parser.add_argument("--deadline", type=float, default=60.0, help="seconds; default 60")
    parser.add_argument("--artifact", metavar="DIR", help="default: the shipped one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, metavar="FILE", help="results as JSON")
    return parser
