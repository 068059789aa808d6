"""One HTML page about a trajectory, complete in itself: it loads nothing from anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from string import Template

import numpy as np
import numpy.typing as npt
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from app.explanation import thinned
from app.odometry.evaluation import Evaluation
from app.report_frame import BLUE, ORANGE, figure_html, framed_page, table_rows
from model.cloud_file import complete_file
from model.odometry import Status, Step, VoxelMap
from model.sequence import FrameSource

FloatArray = npt.NDArray[np.float64]

SHOWN_POINTS = 30_000
_SHOWN_WARNINGS = 50
_TEMPLATE = Path(__file__).with_name("report.html")
_GREY = "#808890"


def write_report(
    path: Path,
    source: FrameSource,
    steps: Sequence[Step],
    truth: Sequence[FloatArray | None],
    evaluation: Evaluation,
    voxels: VoxelMap | None,
    coloured: bool,
) -> None:
    """Write the page: the path, the map, errors and probabilities frame by frame, warnings.

    Args:
        path: the HTML file to write.
        source: of the frames.
        steps: in their order.
        truth: measured T_world_camera (4, 4) of each, or None.
        evaluation: of the steps.
        voxels: the map, or None where no frame had a pose.
        coloured: whether the frames had colours.

    Raises:
        CloudFileError: the file can't be written there.
    """
    body = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        shown="The axes cross in the first frame's camera; z is its line of sight.",
        trajectory=figure_html(_trajectory(steps, truth, evaluation), "trajectory"),
        map=figure_html(_map(voxels, coloured), "map"),
        summary=table_rows(evaluation.lines(), "{}"),
        warnings=table_rows(_warnings(source, steps), "{}"),
        course=figure_html(_course(steps, evaluation), "course"),
    )
    with complete_file(path, "report") as unfinished:
        unfinished.write_text(framed_page(f"Odometry: {source.name}", body), encoding="utf-8")


def _trajectory(
    steps: Sequence[Step], truth: Sequence[FloatArray | None], evaluation: Evaluation
) -> go.Figure:
    """The found path, the measured one laid onto it, and where the camera was lost."""
    found = np.array([step.T_world_camera[:3, 3] for step in steps]).reshape(-1, 3)
    has_pose = np.array([step.status.has_pose for step in steps], dtype=bool)
    figure = go.Figure(_path(np.where(has_pose[:, None], found, np.nan), "found", BLUE))
    if evaluation.absolute is not None:
        T = np.linalg.inv(evaluation.absolute.T_truth_world)
        measured = np.array([np.full(3, np.nan) if pose is None else pose[:3, 3] for pose in truth])
        figure.add_trace(_path(measured @ T[:3, :3].T + T[:3, 3], "measured", ORANGE))
    lost = found[~has_pose]
    if len(lost):
        figure.add_trace(
            go.Scatter3d(
                **_xyz(lost), name="lost", mode="markers", marker={"size": 4, "color": _GREY}
            )
        )
    figure.update_layout(
        scene={"aspectmode": "data"}, height=440, margin={"l": 0, "r": 0, "t": 20, "b": 0}
    )
    return figure


def _map(voxels: VoxelMap | None, coloured: bool) -> go.Figure:
    """The map's points, in their colours or by depth from the first frame."""
    both = np.empty((0, 6)) if voxels is None else np.c_[voxels.points(), voxels.colours()]
    shown = thinned(both, SHOWN_POINTS)
    points, shades = shown[:, :3], np.round(255.0 * shown[:, 3:]).astype(int)
    marker: dict[str, object] = {"size": 1.6}
    if coloured:
        marker["color"] = [f"rgb({r},{g},{b})" for r, g, b in shades]
    else:
        marker |= {"color": points[:, 2].astype(np.float32), "colorscale": "Viridis"}
    hover = "%{x:.3g}, %{y:.3g}, %{z:.3g}"
    figure = go.Figure(
        go.Scatter3d(**_xyz(points), mode="markers", marker=marker, hovertemplate=hover)
    )
    # A camera's y points down, its z ahead.
    scene = {
        "aspectmode": "data",
        "camera": {"up": {"x": 0, "y": -1, "z": 0}, "eye": {"x": 0.3, "y": -0.6, "z": -1.6}},
    }
    figure.update_layout(
        scene=scene, height=440, margin={"l": 0, "r": 0, "t": 20, "b": 0}, showlegend=False
    )
    return figure


def _course(steps: Sequence[Step], evaluation: Evaluation) -> go.Figure:
    """Probability, overlap and residual by frame; the errors, where poses were measured."""
    numbers = [step.number for step in steps]
    curves: list[tuple[str, list[int], Sequence[float | None]]] = [
        ("success probability", numbers, [step.success_probability for step in steps]),
        ("overlap", numbers, [step.overlap for step in steps]),
        ("residual", numbers, [step.rmse for step in steps]),
    ]
    if evaluation.absolute is not None:
        measured = [numbers[row] for row in evaluation.measured]
        curves.append(("position error", measured, evaluation.absolute.distances.tolist()))
        for error in evaluation.relative[:1]:
            later = measured[error.gap :]
            curves.append(("RPE °", later, error.rotations_deg.tolist()))
            curves.append(("RPE", later, error.translations.tolist()))
    figure = make_subplots(rows=len(curves), cols=1, shared_xaxes=True, vertical_spacing=0.03)
    for row, (name, x, y) in enumerate(curves, start=1):
        line = {"color": BLUE, "width": 1.5}
        figure.add_trace(go.Scatter(x=x, y=list(y), name=name, mode="lines", line=line), row, 1)
        figure.update_yaxes(title_text=name, row=row, col=1)
    keys = [step for step in steps if step.keyframe and step.success_probability is not None]
    figure.add_trace(
        go.Scatter(
            x=[step.number for step in keys],
            y=[step.success_probability for step in keys],
            name="keyframe",
            mode="markers",
            marker={"color": ORANGE, "size": 6},
        ),
        1,
        1,
    )
    figure.update_xaxes(title_text="frame", row=len(curves), col=1)
    figure.update_layout(
        showlegend=False, height=150 * len(curves), margin={"l": 70, "r": 20, "t": 20, "b": 45}
    )
    return figure


def _warnings(source: FrameSource, steps: Sequence[Step]) -> list[tuple[str, str]]:
    said = [("Sequence", note) for note in source.notes]
    troubled = [step for step in steps if step.warning]
    said += [
        (f"Frame {step.number}", f"{source.file(step.number)}: {step.warning}")
        for step in troubled[:_SHOWN_WARNINGS]
    ]
    if len(troubled) > _SHOWN_WARNINGS:
        said.append(("More", f"{len(troubled) - _SHOWN_WARNINGS} further frames"))
    relocalised = [str(step.number) for step in steps if step.status is Status.RELOCALISED]
    if relocalised:
        said.append(("Relocalised", "frames " + ", ".join(relocalised[:_SHOWN_WARNINGS])))
    return said or [("None", "every frame was tracked")]


def _path(points: FloatArray, name: str, colour: str) -> go.Scatter3d:
    return go.Scatter3d(**_xyz(points), name=name, mode="lines", line={"color": colour, "width": 4})


def _xyz(points: FloatArray) -> dict[str, npt.NDArray[np.float32]]:
    return {axis: points[:, i].astype(np.float32) for i, axis in enumerate("xyz")}
