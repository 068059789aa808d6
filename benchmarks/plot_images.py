"""Plots as PNG files; matplotlib draws them, and it is optional."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.folder import make_folder
from benchmarks.plot import Plot, Series, colour_of
from model.cloud_file.atomic_file import complete_file

_DOTS_PER_INCH = 110


def write_images(plots: Sequence[Plot], folder: Path) -> str:
    """Write FOLDER/NAME.png for every plot.

    Args:
        plots: what to draw.
        folder: made where it isn't there.

    Returns:
        where they are; or that matplotlib isn't installed.

    Raises:
        CloudFileError: the place can't be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        return f"no PNG plots: the package {error.name} isn't installed"
    make_folder(folder, "out")
    for plot in plots:
        figure = Figure(figsize=(7.2, 4.4), layout="constrained")
        FigureCanvasAgg(figure)
        _draw(plot, figure.add_subplot())
        with complete_file(folder / f"{_file_name(plot.name)}.png", "out") as unfinished:
            figure.savefig(unfinished, dpi=_DOTS_PER_INCH)
    return f"{folder}/: {len(plots)} PNG plots"


def _file_name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()


def _draw(plot: Plot, axes: Any) -> None:
    for series in plot.series:
        _add(series, axes)
    axes.set(title=plot.title, xlabel=plot.x_title, ylabel=plot.y_title)
    axes.set_xscale("log" if plot.log_x else "linear")
    axes.set_yscale("log" if plot.log_y else "linear")
    if plot.y_share:
        axes.set_ylim(0.0, 1.02)
    axes.grid(visible=True, color="#e4e4e4")
    axes.set_axisbelow(True)
    if any(series.name for series in plot.series):
        axes.legend(fontsize="small", frameon=False)


def _add(series: Series, axes: Any) -> None:
    # A label that begins with an underscore stays out of the legend.
    label, colour = series.name or "_", colour_of(series)
    if series.style == "points":
        axes.scatter(series.x, series.y, s=12, alpha=0.6, color=colour, label=label)
    elif series.style == "steps":
        axes.step(series.x, series.y, where="post", color=colour, label=label)
    elif series.style == "guide":
        axes.plot(series.x, series.y, linestyle=":", color=colour, label=label)
    else:
        axes.plot(series.x, series.y, marker="o", markersize=4, color=colour, label=label)
