"""One offline page of plots: error by initial angle, cumulative error, reliability."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from benchmarks.pose_error import ADDS_SUCCESS
from benchmarks.results import Results, Row
from benchmarks.summary import Cell, cells, rows_by_method
from model.exceptions import UnreadableFileError

_COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#444444",
    "#8c6d31",
)
_LEAST_ERROR_DEG = 1e-3
_BINS = 10


def write_plots(results: Results, page: Path) -> None:
    """Write the page; it needs no network.

    Raises:
        UnreadableFileError: the place can't be written.
    """
    figures = [
        figure
        for cell in cells(results)
        for figure in (_by_initial_angle(results, cell), _cumulative(results, cell))
    ]
    figures += [_reliability(results, method) for method in _with_probability(results)]
    bodies = [figure.to_html(full_html=False, include_plotlyjs=False) for figure in figures]
    title = f"{results.benchmark} benchmark"
    try:
        page.write_text(
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
            f"<script>{get_plotlyjs()}</script></head>"
            f'<body style="font-family: sans-serif"><h1>{title}</h1>{"".join(bodies)}</body></html>'
        )
    except OSError as error:
        raise UnreadableFileError(
            f"the plots can't be written: {error.strerror}",
            field="out",
            value=page,
            mend="give a file in a folder that exists and can be written",
        ) from error


def _by_initial_angle(results: Results, cell: Cell) -> go.Figure:
    figure = _empty(f"{_title(cell)}: error by initial angle", "initial angle / °", "error / °")
    for method, rows in rows_by_method(results, cell).items():
        figure.add_scatter(
            x=[results.pairs[row.pair].initial_deg for row in rows],
            y=_floored([row.error.rotation_deg for row in rows]),
            text=[results.pairs[row.pair].entry.subject_name for row in rows],
            mode="markers",
            name=method,
            marker={"color": _colour(results, method), "size": 6, "opacity": 0.7},
        )
    figure.update_yaxes(type="log")
    return figure


def _cumulative(results: Results, cell: Cell) -> go.Figure:
    figure = _empty(f"{_title(cell)}: share of pairs below an error", "error / °", "share")
    for method, rows in rows_by_method(results, cell).items():
        errors = np.sort(_floored([row.error.rotation_deg for row in rows]))
        figure.add_scatter(
            x=errors,
            y=np.arange(1, len(errors) + 1) / len(errors),
            mode="lines",
            line={"shape": "hv", "color": _colour(results, method)},
            name=method,
        )
    figure.update_xaxes(type="log")
    figure.update_yaxes(range=[0.0, 1.02])
    return figure


def _reliability(results: Results, method: str) -> go.Figure:
    """How often a pose is right among those that were said to be right with some probability."""
    figure = _empty(
        f"{method}: reliability of the success probability", "stated probability", "success"
    )
    rows = [row for row in results.rows.values() if row.method == method]
    stated = np.array([row.findings["success_probability"] for row in rows])
    right = np.array([_succeeded(row) for row in rows])
    bins = np.minimum((stated * _BINS).astype(int), _BINS - 1)
    used = np.unique(bins)
    figure.add_scatter(
        x=[stated[bins == b].mean() for b in used],
        y=[right[bins == b].mean() for b in used],
        text=[f"{(bins == b).sum()} pairs" for b in used],
        mode="lines+markers",
        name=f"{method}, {len(rows)} pairs",
        line={"color": _colour(results, method)},
    )
    figure.add_scatter(
        x=[0.0, 1.0], y=[0.0, 1.0], mode="lines", name="calibrated", line={"dash": "dot"}
    )
    return figure


def _with_probability(results: Results) -> list[str]:
    """Methods that state a probability for each of their poses."""
    return [
        method
        for method in results.methods
        if (rows := [row for row in results.rows.values() if row.method == method])
        and all("success_probability" in row.findings for row in rows)
    ]


def _succeeded(row: Row) -> bool:
    if row.error.adds is not None:
        return row.error.adds < ADDS_SUCCESS
    return row.error.rotation_deg < 5.0


def _empty(title: str, x: str, y: str) -> go.Figure:
    return go.Figure(
        layout={
            "title": title,
            "xaxis_title": x,
            "yaxis_title": y,
            "template": "plotly_white",
            "height": 420,
        }
    )


def _title(cell: Cell) -> str:
    return f"{cell.group}, {cell.turn}, {cell.column}"


def _colour(results: Results, method: str) -> str:
    return _COLOURS[list(results.methods).index(method) % len(_COLOURS)]


def _floored(errors: Sequence[float]) -> list[float]:
    """A logarithmic axis has no place for 0."""
    return [max(error, _LEAST_ERROR_DEG) for error in errors]
