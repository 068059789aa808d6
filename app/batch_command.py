"""``equivalign batch``: a list of pairs in, a folder of results out."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from app.cores import usable_cores

if TYPE_CHECKING:
    from app.batch.worker import ShardDone


def batch_command(arguments: list[str]) -> int:
    """Register the pairs that a file lists, on many workers; a re-run goes on where it stopped."""
    given = _parser().parse_args(arguments)
    from app.batch.run import Batch, run_batch

    batch = Batch(
        manifest=given.pairs,
        out=given.out,
        artifact=given.artifact,
        engine=given.engine,
        workers=given.workers,
        address=given.address,
        shard=given.shard,
        root=given.root,
        retry_errors=given.retry_errors,
    )
    with _Progress() as progress:
        summary = run_batch(batch, progress)
    _print(given, summary)
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="equivalign batch",
        description="Register pairs of clouds. The manifest has the columns source and target: "
        "paths, relative to its own folder, or URLs; and, where wanted, pair_id and any option of "
        "POST /register. A pair that can't be registered is a row with an error.",
    )
    parser.add_argument("pairs", metavar="PAIRS", help="manifest, .parquet, .csv or .jsonl")
    parser.add_argument(
        "--out", required=True, metavar="FOLDER", help="results as Parquet; path or URL"
    )
    parser.add_argument("--artifact", metavar="DIR", help="trained artifact")
    parser.add_argument(
        "--engine", choices=["ray", "processes"], help="default: Ray where it is installed"
    )
    parser.add_argument(
        "--workers", type=int, default=usable_cores(), help="of one core each; default all here"
    )
    parser.add_argument(
        "--address", metavar="ADDRESS", help="of a Ray cluster, or auto; default: this machine"
    )
    parser.add_argument(
        "--shard", type=int, metavar="PAIRS", help="pairs in a file; default up to 64"
    )
    parser.add_argument(
        "--root", metavar="FOLDER", help="what paths are relative to; default: the manifest's"
    )
    parser.add_argument(
        "--retry-errors", action="store_true", help="register anew what had an error"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    return parser


class _Progress:
    """A bar on stderr, where that is a terminal."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeRemainingColumn,
        )

        console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[errors]} errors"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("registering", total=None, errors=0)
        self._errors = 0

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, pairs: int, done: ShardDone | None) -> None:
        """Tell how many pairs there are, or that a shard is done."""
        self._bar.update(self._task, total=pairs)
        if done is not None:
            self._errors += done.errors
            self._bar.update(self._task, advance=done.pairs, errors=self._errors)


def _print(given: Namespace, summary: dict[str, Any]) -> None:
    if given.json:
        print(json.dumps(summary, allow_nan=False))
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, value in _in_words(summary):
        table.add_row(name, value)
    Console(highlight=False).print(table)


def _in_words(summary: dict[str, Any]) -> list[tuple[str, str]]:
    errors = summary["errors"]
    speed = summary["pairs_per_second"]
    said = [
        ("Pairs", f"{summary['pairs']}, {summary['finished_before']} finished before"),
        (
            "Succeeded",
            f"{summary['succeeded']}, {summary['trusted']} of them with a probability ≥ 0.9, "
            f"{summary['not_converged']} not converged",
        ),
        (
            "Errors",
            f"{sum(errors.values())}"
            + "".join(f", {count} {kind}" for kind, count in errors.items()),
        ),
    ]
    if speed is not None:
        said.append(
            ("Speed", f"{speed:g} pairs/s on {summary['workers']} workers ({summary['engine']})")
        )
    return [*said, ("Results", summary["results"])]
