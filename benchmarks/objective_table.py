"""The table of ``objectives``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import mean, stdev
from typing import Any

from benchmarks.markdown import markdown
from benchmarks.objective import OBJECTIVES
from benchmarks.objective_study import MEASURED
from benchmarks.provenance import Provenance
from benchmarks.sheet import Sheet

COLUMNS = [f"{kind}, {solver}" for kind, solver in MEASURED]
_HEAD = [
    "objective",
    "angles",
    "seeds",
    *COLUMNS,
    "median °",
    "effective rank",
    "s",
]


def objective_sheets(content: dict[str, Any]) -> list[Sheet]:
    """Mean and standard deviation over the seeds, one row an objective and curriculum."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in content["rows"]:
        groups.setdefault((row["objective"], row["curriculum"]), []).append(row)
    order = {name: place for place, name in enumerate(OBJECTIVES)}
    rows = [
        _row(name, curriculum, groups[name, curriculum])
        for name, curriculum in sorted(groups, key=lambda key: (order.get(key[0], 0), key[1]))
    ]
    settings = content["settings"]
    note = (
        f"Share of {settings['test_pairs']} pairs within 5°, % (mean ± standard deviation over "
        f"seeds). {settings['points']} points a cloud; {settings['steps']} outer steps of "
        f"{settings['batch_size']} pairs. Fine: ℓ from {settings['solvers']['fine'][0]} to "
        f"{settings['solvers']['fine'][1]}; coarse: from {settings['solvers']['coarse'][0]} to "
        f"{settings['solvers']['coarse'][1]}. Median error of resampled pairs, fine."
    )
    return [Sheet("Recall at 5° from 45°, one start, no search", _HEAD, rows, 2, note)]


def _row(name: str, curriculum: str, rows: Sequence[dict[str, Any]]) -> list[str]:
    trained = OBJECTIVES[name].encoder == "trained" if name in OBJECTIVES else True
    found = [row["measured"] for row in rows]
    recalls = [_share([one[column]["recall"] for one in found]) for column in COLUMNS]
    ranks = [one["features"]["effective_rank"] for one in found if "features" in one]
    return [
        name,
        curriculum if trained else "–",
        str(len(rows)),
        *recalls,
        f"{mean(one['resampled, fine']['median_deg'] for one in found):.1f}",
        f"{mean(ranks):.1f}" if ranks else "–",
        f"{mean(row['seconds'] for row in rows):.0f}" if trained else "–",
    ]


def _share(values: Sequence[float]) -> str:
    spread = stdev(values) if len(values) > 1 else math.nan
    return f"{100 * mean(values):.1f}" + ("" if math.isnan(spread) else f" ± {100 * spread:.1f}")


def document(content: dict[str, Any]) -> str:
    """The sheets as Markdown, with the commands that made them."""
    runs = {Provenance(**row["provenance"]) for row in content["rows"]}
    lines = [
        f"- `{run.command}` ({run.date} UTC; {run.cpu}, {run.cores} cores, {run.threads} threads, "
        f"load {run.load}; commit {run.commit}; PyTorch {run.torch})"
        for run in sorted(runs, key=lambda run: run.date)
    ]
    sheets = [markdown(sheet) for sheet in objective_sheets(content)]
    return "\n".join([*sheets, *lines, ""])
