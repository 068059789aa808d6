"""The tables of ``scaling``: costs of a pair, what they predict, and what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.scaling_model import drawn_shards, simulated
from benchmarks.sheet import Sheet

Measured = dict[str, Any]

_SHARDS = (16, 64, 256)
_WORKERS = (1, 2, 10, 100, 1000)


@dataclass(frozen=True, slots=True)
class Measurements:
    """All parts that were measured.

    Attributes:
        alone: in a single process, without an engine.
        runs: with each engine and number of workers.
        dispatch_seconds: that the driver needs for one shard.
        points: of each cloud.
    """

    alone: Measured
    runs: Sequence[Measured]
    dispatch_seconds: float
    points: int

    def one_worker(self, engine: str) -> Measured | None:
        """The run of the same engine on one worker."""
        same = [run for run in self.runs if (run["engine"], run["workers"]) == (engine, 1)]
        return same[0] if same else None


def scaling_sheets(measured: Measurements, pairs: int) -> list[Sheet]:
    """The tables.

    Args:
        measured: all parts.
        pairs: of the batch that is extrapolated to.
    """
    return [_measured(measured), _costs(measured), _extrapolated(measured, pairs)]


def _measured(measured: Measurements) -> Sheet:
    alone = measured.alone
    rate = alone["pairs"] / alone["work_seconds"]
    dash = "–"
    rows = [["single process", dash, f"{alone['work_seconds']:.1f}", f"{rate:.2f}", *[dash] * 4]]
    for run in measured.runs:
        row = [
            f"{run['engine']}, {run['workers']}",
            f"{run['start_seconds']:.1f}",
            f"{run['work_seconds']:.1f}",
            f"{run['pairs'] / run['work_seconds']:.2f}",
        ]
        one = measured.one_worker(run["engine"])
        if one is None:
            row += [dash] * 3
        else:
            expected = simulated(one["shard_seconds"], run["workers"], measured.dispatch_seconds)
            row += [
                f"{expected.seconds:.1f}",
                f"{one['work_seconds'] / run['work_seconds']:.2f}",
                f"{one['whole_seconds'] / run['whole_seconds']:.2f}",
            ]
        rows.append([*row, f"{run['equal_to_alone']} of {run['pairs']}"])
    head = ["engine, workers", "start, s", "work, s", "pairs/s", "predicted work, s"]
    head += ["× one worker", "× with start and end", "poses equal bit for bit"]
    note = "Each worker is pinned to one core and has one thread. Start is from the command to the "
    note += "first pair."
    return Sheet(f"{alone['pairs']} pairs", head, rows, note=note)


def _costs(measured: Measurements) -> Sheet:
    run = measured.runs[0]
    stages = {"reading": run["reading_seconds"], **run["stage_seconds"]}
    total = stages.pop("total")
    stages["all else"] = run["row_seconds"] - run["reading_seconds"] - total
    rows = [[f"{stage}, ms", f"{seconds * 1000:.1f}"] for stage, seconds in stages.items()]
    rows += [
        ["a pair, ms", f"{run['row_seconds'] * 1000:.1f}"],
        ["pairs/s a core", f"{1.0 / run['row_seconds']:.2f}"],
        ["read a pair, kB", f"{run['input_bytes'] / 1000:.1f}"],
        ["written a pair, kB", f"{run['result_bytes'] / 1000:.1f}"],
        ["a worker's own memory, MiB", f"{run['worker_mib']:.0f}"],
        ["all other processes, MiB", f"{run['around_mib']:.0f}"],
        ["the driver for a shard, ms", f"{measured.dispatch_seconds * 1000:.1f}"],
    ]
    title = f"Costs of a pair of two clouds of {measured.points} points"
    return Sheet(f"{title}, {run['engine']}, {run['workers']} worker", ["cost", "mean"], rows)


def _extrapolated(measured: Measurements, pairs: int) -> Sheet:
    rows = []
    for size in _SHARDS:
        shards = drawn_shards(measured.runs[0]["pair_seconds"], pairs, size)
        for workers in _WORKERS:
            growth = simulated(shards, workers, measured.dispatch_seconds)
            rows.append(
                [
                    str(size),
                    str(workers),
                    f"{growth.seconds / 60:.1f}",
                    f"{pairs / growth.seconds:.0f}",
                    f"{growth.efficiency:.0%}",
                ]
            )
    return Sheet(
        f"Simulated: {pairs} such pairs",
        ["pairs a shard", "workers", "minutes", "pairs/s", "workers busy"],
        rows,
        labels=2,
    )
