"""Plots in one HTML page that needs no network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from benchmarks.plot import Plot, Series, colour_of
from model.cloud_file.atomic_file import complete_file


def write_page(title: str, plots: Sequence[Plot], page: Path) -> None:
    """Write the page whole.

    Args:
        title: of the page.
        plots: one below the other.
        page: the file.

    Raises:
        CloudFileError: the place can't be written.
    """
    bodies = [_figure(plot).to_html(full_html=False, include_plotlyjs=False) for plot in plots]
    with complete_file(page, "out") as unfinished:
        unfinished.write_text(
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
            f'<script>{get_plotlyjs()}</script></head><body style="font-family: sans-serif">'
            f"<h1>{title}</h1>{''.join(bodies)}</body></html>\n"
        )


def _figure(plot: Plot) -> go.Figure:
    figure = go.Figure(
        layout={
            "title": plot.title,
            "xaxis": {"title": plot.x_title, "type": "log" if plot.log_x else "linear"},
            "yaxis": {"title": plot.y_title, "type": "log" if plot.log_y else "linear"},
            "template": "plotly_white",
            "height": 420,
        }
    )
    for series in plot.series:
        figure.add_scatter(
            x=series.x,
            y=series.y,
            name=series.name,
            showlegend=bool(series.name),
            text=series.texts or None,
            **_drawn(series),
        )
    if plot.y_share:
        figure.update_yaxes(range=[0.0, 1.02])
    return figure


def _drawn(series: Series) -> dict[str, Any]:
    colour = colour_of(series)
    if series.style == "points":
        return {"mode": "markers", "marker": {"color": colour, "size": 6, "opacity": 0.6}}
    if series.style == "steps":
        return {"mode": "lines", "line": {"shape": "hv", "color": colour}}
    if series.style == "guide":
        return {"mode": "lines", "line": {"dash": "dot", "color": colour}}
    return {"mode": "lines+markers", "line": {"color": colour}}
