"""The tables of ``scaling``: costs of a pair, a prediction from them, and what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.sheet import Sheet

Measured = dict[str, Any]


def predicted_seconds(one: Measured, workers: int) -> float:
    """What so many workers should take for the work that one did, if they share nothing.

    Args:
        one: measured with one worker.
        workers: each on a core of its own.
    """
    seconds: float = one["work_seconds"] / workers
    return seconds


def scaling_sheets(alone: Measured, runs: Sequence[Measured], points: int) -> list[Sheet]:
    """The tables.

    Args:
        alone: measured in a single process, without an engine.
        runs: measured with each number of workers.
        points: of each cloud.
    """
    return [_growth_sheet(alone, runs), _cost_sheet(runs[0], points)]


def _growth_sheet(alone: Measured, runs: Sequence[Measured]) -> Sheet:
    rows = [
        [
            "single process",
            "–",
            f"{alone['work_seconds']:.1f}",
            f"{alone['pairs'] / alone['work_seconds']:.2f}",
            "–",
            "–",
            "–",
            "–",
        ]
    ]
    for run in runs:
        one = next((r for r in runs if r["workers"] == 1 and r["engine"] == run["engine"]), None)
        rows.append(
            [
                f"{run['engine']}, {run['workers']}",
                f"{run['start_seconds']:.1f}",
                f"{run['work_seconds']:.1f}",
                f"{run['pairs'] / run['work_seconds']:.2f}",
                "–" if one is None else f"{predicted_seconds(one, run['workers']):.1f}",
                "–" if one is None else f"{one['work_seconds'] / run['work_seconds']:.2f}",
                "–" if one is None else f"{one['whole_seconds'] / run['whole_seconds']:.2f}",
                f"{run['equal_to_alone']} of {run['pairs']}",
            ]
        )
    return Sheet(
        f"{alone['pairs']} pairs",
        [
            "engine, workers",
            "start, s",
            "work, s",
            "pairs/s",
            "predicted work, s",
            "× one worker",
            "× with start and end",
            "poses equal bit for bit",
        ],
        rows,
        note="Each worker is pinned to one core and has one thread. Start is from the command to "
        "the first pair.",
    )


def _cost_sheet(run: Measured, points: int) -> Sheet:
    stages = {"reading": run["reading_seconds"], **run["stage_seconds"]}
    total = stages.pop("total")
    other = run["row_seconds"] - run["reading_seconds"] - total
    rows = [
        [f"{stage}, ms", f"{seconds * 1000:.1f}"]
        for stage, seconds in {**stages, "all else": other}.items()
    ]
    rows += [
        ["a pair, ms", f"{run['row_seconds'] * 1000:.1f}"],
        ["pairs/s a core", f"{1.0 / run['row_seconds']:.2f}"],
        ["read a pair, kB", f"{run['input_bytes'] / 1000:.1f}"],
        ["written a pair, kB", f"{run['result_bytes'] / 1000:.1f}"],
        ["a worker's own memory, MiB", f"{run['worker_mib']:.0f}"],
        ["all other processes, MiB", f"{run['around_mib']:.0f}"],
    ]
    return Sheet(
        f"Costs of a pair of two clouds of {points} points, {run['engine']}, "
        f"{run['workers']} worker",
        ["cost", "mean"],
        rows,
    )
