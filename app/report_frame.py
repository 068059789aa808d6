"""What all reports share: a page that loads nothing from anywhere, its figures and its tables."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

# Blue and orange stay apart for colour-blind readers, on white and on black.
ORANGE, BLUE = "#e08214", "#3b8fd4"

_FRAME = Path(__file__).with_name("report_frame.html")


def framed_page(title: str, body: str) -> str:
    """A page around a body of HTML; what the body holds must be escaped already."""
    return Template(_FRAME.read_text(encoding="utf-8")).substitute(
        title=escape(title), plotly=get_plotlyjs(), body=body
    )


def figure_html(figure: go.Figure, name: str) -> str:
    """A figure as HTML that takes its colours from the page; its name is unique in the page."""
    figure.update_layout(
        template="none",
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        legend={"orientation": "h", "y": 1.02, "x": 0, "itemsizing": "constant"},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": "#808890"},
    )
    config: dict[str, Any] = {"responsive": True, "displaylogo": False}
    html: str = figure.to_html(
        full_html=False, include_plotlyjs=False, div_id=name, config=config, default_width="100%"
    )
    return html


def table_rows(lines: Iterable[tuple[str, str]], cell: str) -> str:
    """Rows of (subject, statement), escaped; each statement is put into the cell's ``{}``."""
    return "".join(
        f"<tr><th>{escape(subject)}</th><td>{cell.format(escape(statement))}</td></tr>"
        for subject, statement in lines
    )
