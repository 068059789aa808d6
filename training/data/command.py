"""``equivalign data``: make training data out of files, and fetch public sets."""

from __future__ import annotations

from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser, Namespace
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from training.data.fetch import DATASETS, eth3d_sequences, fetch
from training.data.pack import LAYOUTS, find_origin, pack
from training.data.shape_files import skipped_list


def data_command(argv: list[str]) -> int:
    """Pack clouds and meshes for training, or fetch a public data set."""
    given = _parser().parse_args(argv)
    console = Console(stderr=True)
    if given.subcommand == "pack":
        return _pack(given, console)
    return _fetch(given, console)


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign data", description="Data for training.")
    subcommands = parser.add_subparsers(dest="subcommand", required=True)
    packing = subcommands.add_parser(
        "pack",
        help="pack clouds and meshes into archives that load at once",
        description="Read every shape once, sample it evenly, and write archives for PackedData. "
        "Run it again after an interruption: it goes on where it stopped.",
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    packing.add_argument(
        "source", type=Path, metavar="SRC", help="folder of files, ModelNet, or .npz archive"
    )
    packing.add_argument("out", type=Path, metavar="OUT", help="new folder for the archives")
    packing.add_argument("--layout", choices=LAYOUTS, default="auto", help="what SRC is")
    packing.add_argument("--points", type=int, default=4096, help="points a shape")
    packing.add_argument("--seed", type=int, default=0, help="of the samples")
    packing.add_argument("--workers", type=int, default=2, help="processes that read")
    packing.add_argument("--shard-size", type=int, default=512, help="shapes an archive")
    fetching = subcommands.add_parser(
        "fetch",
        help="download a public data set from its official address",
        description="Download, check and unpack a public data set. Run it again after an "
        "interruption: it goes on where it stopped. Mind the licences: ModelNet and ETH3D are for "
        "research.",
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    fetching.add_argument("dataset", choices=[*DATASETS, "eth3d"], metavar="DATASET",
                          help=f"one of {', '.join([*DATASETS, 'eth3d'])}")  # fmt: skip
    fetching.add_argument("out", type=Path, metavar="OUT", help="folder to put it into")
    fetching.add_argument(
        "--sequence", action="append", metavar="NAME",
        help="of ETH3D only this sequence; may be given several times (default: all for training)",
    )  # fmt: skip
    return parser


def _pack(given: Namespace, console: Console) -> int:
    origin = find_origin(given.source, given.layout, given.points, given.seed)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
               TimeRemainingColumn())  # fmt: skip
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("packing", total=len(origin.entries))
        report = pack(
            origin, given.out, given.shard_size, given.workers,
            advance=lambda count: progress.advance(task, count),
        )  # fmt: skip
    if report.skipped:
        console.print(
            skipped_list(report.skipped, len(origin.entries)), markup=False, soft_wrap=True
        )
    console.print(f"{report.packed} shapes in {given.out}", markup=False, soft_wrap=True)
    return 0


def _fetch(given: Namespace, console: Console) -> int:
    if given.dataset == "eth3d":
        wanted = eth3d_sequences(given.out, given.sequence)
    else:
        wanted = [DATASETS[given.dataset]]
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(),
               TransferSpeedColumn(), TimeRemainingColumn())  # fmt: skip
    for dataset in wanted:
        with Progress(*columns, console=console) as progress:
            place = fetch(dataset, given.out, _Downloads(progress))
        console.print(f"{dataset.name} is in {place}", markup=False, soft_wrap=True)
    return 0


class _Downloads:
    """A bar for every file."""

    def __init__(self, progress: Progress) -> None:
        self.progress = progress
        self.tasks: dict[str, TaskID] = {}

    def __call__(self, name: str, done: int, total: int | None) -> None:
        if name not in self.tasks:
            self.tasks[name] = self.progress.add_task(name)
        self.progress.update(self.tasks[name], completed=done, total=total)
