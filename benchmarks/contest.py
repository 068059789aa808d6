"""Runs every competitor on every pair, and goes on where an earlier run stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks.competitor import Competitor
from benchmarks.pair import BenchmarkPair, PairEntry
from benchmarks.pose_error import PoseError
from benchmarks.provenance import Provenance
from benchmarks.results import Results, Row

_SECONDS_BETWEEN_WRITES = 10.0


def hold_contest(
    entries: Sequence[PairEntry],
    make: Callable[[PairEntry], BenchmarkPair],
    competitors: Sequence[Competitor],
    results: Results,
    provenance: Provenance,
    out: Path | None,
    progress: Progress,
) -> None:
    """Fill in the rows that are missing.

    Competitors take turns on each pair, each time another one first, so that a busy machine is
    unfair to none of them. Each registers one pair off the record before: libraries load then.

    Args:
        entries: the list of pairs.
        make: gives a pair's arrays.
        competitors: who answers.
        results: gets the rows.
        provenance: of this run.
        out: written every few seconds and at the end, also after an interruption.
        progress: shows how far it is.

    Raises:
        InvalidOptionError: the results are of other settings or other arrays.
    """
    for competitor in competitors:
        results.admit(competitor.name, competitor.settings)
    missing = [entry for entry in entries if _absent(entry, competitors, results)]
    if missing:
        if provenance not in results.runs:
            results.runs.append(provenance)
        _warm_up(make(missing[0]), competitors)
    task = progress.add_task("pairs", total=len(entries), completed=len(entries) - len(missing))
    written = time.monotonic()
    try:
        for number, entry in enumerate(missing):
            pair = make(entry)
            results.list_pair(pair)
            first = number % len(competitors)
            for competitor in (*competitors[first:], *competitors[:first]):
                if (entry.name, competitor.name) not in results.rows:
                    results.add(_measured(competitor, pair, len(results.runs) - 1))
            progress.advance(task)
            if out is not None and time.monotonic() - written > _SECONDS_BETWEEN_WRITES:
                results.write(out)
                written = time.monotonic()
    finally:
        if out is not None:
            results.write(out)


def contest_progress() -> Progress:
    """A progress bar with the time that is left."""
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    )


def _absent(entry: PairEntry, competitors: Sequence[Competitor], results: Results) -> bool:
    return any((entry.name, competitor.name) not in results.rows for competitor in competitors)


def _warm_up(pair: BenchmarkPair, competitors: Sequence[Competitor]) -> None:
    for competitor in competitors:
        competitor.answer(pair)


def _measured(competitor: Competitor, pair: BenchmarkPair, run: int) -> Row:
    timed = competitor.answer(pair)
    T = timed.answer.T_target_source
    return Row(
        pair=pair.entry.name,
        method=competitor.name,
        run=run,
        error=PoseError.of(T, pair),
        seconds=timed.seconds,
        T_target_source=T.tolist(),
        findings=timed.answer.findings,
    )
