"""One HTML page about one registration, complete in itself: it loads nothing from anywhere."""

from __future__ import annotations

from pathlib import Path
from string import Template

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from app.explanation import thinned
from app.findings import findings, pose_lines
from app.report_frame import BLUE, ORANGE, figure_html, framed_page, table_rows
from model import Iteration, RegistrationResult
from model.cloud_file import complete_file

FloatArray = npt.NDArray[np.float64]

SHOWN_POINTS = 5000

_SOURCE, _TARGET = ORANGE, BLUE
_TEMPLATE = Path(__file__).with_name("report.html")


def write_report(
    path: Path,
    title: str,
    source: FloatArray,
    target: FloatArray,
    result: RegistrationResult,
) -> None:
    """Write the page: both clouds before and after, the convergence, the pose and diagnostics.

    Args:
        path: the HTML file to write.
        title: names the pair.
        source: (M, 3), in the input's unit.
        target: (N, 3), in the input's unit.
        result: of their registration.

    Raises:
        CloudFileError: the file can't be written there.
    """
    page = report_page(title, source, target, result)
    with complete_file(path, "report") as unfinished:
        unfinished.write_text(page, encoding="utf-8")


def report_page(
    title: str, source: FloatArray, target: FloatArray, result: RegistrationResult
) -> str:
    """The page as text; see ``write_report``."""
    # Far from the origin, as in UTM, the browser's float32 would move the points.
    origin = target.mean(axis=0)
    shown_source, shown_target = thinned(source, SHOWN_POINTS), thinned(target, SHOWN_POINTS)
    body = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        before=figure_html(_clouds(shown_source - origin, shown_target - origin), "before"),
        after=figure_html(
            _clouds(result.transform(shown_source) - origin, shown_target - origin), "after"
        ),
        convergence=figure_html(_convergence(result.diagnostics.trace), "convergence"),
        shown=_shown(source, target),
        pose=table_rows(pose_lines(result), "<pre>{}</pre>"),
        findings=table_rows(findings(result.diagnostics), "{}"),
    )
    return framed_page(title, body)


def _shown(source: FloatArray, target: FloatArray) -> str:
    thinned = [
        f"The page shows {SHOWN_POINTS} of {len(cloud)} {name} points."
        for name, cloud in (("source", source), ("target", target))
        if len(cloud) > SHOWN_POINTS
    ]
    return " ".join(["The axes cross in the target's centroid.", *thinned])


def _clouds(source: FloatArray, target: FloatArray) -> go.Figure:
    figure = go.Figure(
        [
            go.Scatter3d(
                x=points[:, 0].astype(np.float32),
                y=points[:, 1].astype(np.float32),
                z=points[:, 2].astype(np.float32),
                name=name,
                mode="markers",
                marker={"size": 3, "color": colour, "symbol": symbol},
                hovertemplate="%{x:.4g}, %{y:.4g}, %{z:.4g}",
            )
            # Rings leave what they lie on visible.
            for name, points, colour, symbol in (
                ("target", target, _TARGET, "circle"),
                ("source", source, _SOURCE, "circle-open"),
            )
        ]
    )
    figure.update_layout(
        scene={"aspectmode": "data"}, height=440, margin={"l": 0, "r": 0, "t": 20, "b": 0}
    )
    return figure


def _convergence(trace: list[Iteration]) -> go.Figure:
    """ρ, d and ℓ over the iterations, one above the other."""
    curves = {
        "similarity ρ": [step.similarity for step in trace],
        "RKHS distance d": [step.rkhs_distance for step in trace],
        "lengthscale ℓ": [step.lengthscale for step in trace],
    }
    figure = make_subplots(rows=len(curves), cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for row, (name, values) in enumerate(curves.items(), start=1):
        steps = list(range(1, len(values) + 1))
        line = {"color": _TARGET}
        figure.add_trace(
            go.Scatter(x=steps, y=values, name=name, mode="lines+markers", line=line), row, 1
        )
        figure.update_yaxes(title_text=name, row=row, col=1)
    figure.update_xaxes(title_text="iteration", row=len(curves), col=1)
    figure.update_layout(showlegend=False, height=560, margin={"l": 70, "r": 20, "t": 20, "b": 45})
    return figure
