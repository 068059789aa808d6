"""A plot before it is drawn: as an image or in a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

Style = Literal["points", "line", "steps", "guide"]

# Told apart by people who see few colours (Okabe and Ito), then by lightness.
COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#444444",
    "#8c6d31",
)


@dataclass(frozen=True, slots=True)
class Series:
    """One method's share of a plot.

    Attributes:
        name: in the legend; empty for none.
        x: positions.
        y: as many values.
        style: ``points``, ``line``, ``steps`` (up at each x) or ``guide`` (dotted, grey).
        colour: index into ``COLOURS``.
        texts: what each point is, or nothing.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    style: Style
    colour: int = 0
    texts: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Plot:
    """Axes and what is drawn in them.

    Attributes:
        name: of its file.
        title: above it.
        x_title: of the axis.
        y_title: of the axis.
        series: drawn in this order.
        log_x: whether the axis is logarithmic.
        log_y: whether the axis is logarithmic.
        y_share: whether y runs from 0 to 1.
    """

    name: str
    title: str
    x_title: str
    y_title: str
    series: Sequence[Series] = field(default_factory=list)
    log_x: bool = False
    log_y: bool = False
    y_share: bool = False


def colour_of(series: Series) -> str:
    """As hexadecimal digits."""
    return "#888888" if series.style == "guide" else COLOURS[series.colour % len(COLOURS)]
