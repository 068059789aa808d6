"""What a results file shows at a glance: error by initial angle, cumulative error, reliability."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.calibration import Calibration, with_probability
from benchmarks.plot import Plot, Series
from benchmarks.plot_images import write_images
from benchmarks.plot_page import write_page
from benchmarks.results import Results, Row
from benchmarks.summary import Cell, cells, rows_by_method

_LEAST_ERROR_DEG = 1e-3
_ANGLE_BIN_DEG = 20.0


def write_plots(results: Results, out: Path) -> list[str]:
    """Draw all plots beside a results file: OUT.html, and OUT/NAME.png where matplotlib is.

    Args:
        results: at least one answer.
        out: the results file.

    Returns:
        what was written, or why not, a line each.

    Raises:
        CloudFileError: a place can't be written.
    """
    drawn = result_plots(results)
    page = out.with_suffix(".html")
    write_page(f"{results.benchmark} benchmark", drawn, page)
    return [str(page), write_images(drawn, out.with_suffix(""))]


def result_plots(results: Results) -> list[Plot]:
    """By initial angle for every column, cumulative for every cell, reliability for every method.

    Args:
        results: the answers.
    """
    found = cells(results)
    columns = dict.fromkeys((cell.group, cell.column) for cell in found)
    return [
        *(
            _by_initial_angle(results, [c for c in found if (c.group, c.column) == column])
            for column in columns
        ),
        *(_cumulative(results, cell) for cell in found),
        *(_reliability(results, method) for method in with_probability(results)),
    ]


def _by_initial_angle(results: Results, found: Sequence[Cell]) -> Plot:
    """All turns of one column; with a line through the medians where the angles differ."""
    group, column = found[0].group, found[0].column
    series = []
    for method in results.methods:
        rows = [row for cell in found for row in rows_by_method(results, cell).get(method, [])]
        if rows:
            series += _scattered(results, method, rows)
    return Plot(
        name=f"error_by_angle_{group}_{column}",
        title=f"{group}, {column}: error by initial angle",
        x_title="initial angle / °",
        y_title="rotation error / °",
        series=series,
        log_y=True,
    )


def _scattered(results: Results, method: str, rows: Sequence[Row]) -> list[Series]:
    angles = np.array([results.pairs[row.pair].initial_deg for row in rows])
    errors = np.array(_floored([row.error.rotation_deg for row in rows]))
    colour = _colour(results, method)
    names = [results.pairs[row.pair].entry.subject_name for row in rows]
    points = Series(method, angles.tolist(), errors.tolist(), "points", colour, names)
    bins = (angles / _ANGLE_BIN_DEG).round()
    used = np.unique(bins)
    if len(used) == 1:
        return [points]
    middles = [float(angles[bins == b].mean()) for b in used]
    medians = [float(np.median(errors[bins == b])) for b in used]
    return [points, Series("", middles, medians, "line", colour)]


def _cumulative(results: Results, cell: Cell) -> Plot:
    series = []
    for method, rows in rows_by_method(results, cell).items():
        errors = np.sort(_floored([row.error.rotation_deg for row in rows]))
        shares = np.arange(1, len(errors) + 1) / len(errors)
        colour = _colour(results, method)
        series.append(Series(method, errors.tolist(), shares.tolist(), "steps", colour))
    return Plot(
        name=f"cumulative_{cell.group}_{cell.turn}_{cell.column}",
        title=f"{cell.group}, {cell.turn}, {cell.column}: share of pairs below an error",
        x_title="rotation error / °",
        y_title="share",
        series=series,
        log_x=True,
        y_share=True,
    )


def _reliability(results: Results, method: str) -> Plot:
    """How often a pose is right among those that were said to be right with some probability."""
    calibration = Calibration.of(results, method)
    bins = calibration.bins()
    measured = Series(
        f"{method}, {len(calibration.stated)} pairs, "
        f"expected calibration error {calibration.expected_error:.3f}",
        [stated for stated, _, _ in bins],
        [right for _, right, _ in bins],
        "line",
        _colour(results, method),
        [f"{count} pairs" for _, _, count in bins],
    )
    return Plot(
        name=f"reliability_{method}",
        title=f"{method}: reliability of the success probability",
        x_title="stated probability",
        y_title="share of successes",
        series=[measured, Series("calibrated", [0.0, 1.0], [0.0, 1.0], "guide")],
        y_share=True,
    )


def _colour(results: Results, method: str) -> int:
    return list(results.methods).index(method)


def _floored(errors: Sequence[float]) -> list[float]:
    """A logarithmic axis has no place for 0."""
    return [max(error, _LEAST_ERROR_DEG) for error in errors]
