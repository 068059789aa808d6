"""The tables of a results file."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.calibration import Calibration, with_probability
from benchmarks.figures import decimals, figures_of, percent
from benchmarks.pose_error import ADDS_SUCCESS
from benchmarks.printed import (
    ABLATION_SOURCE,
    ABLATIONS,
    FRAMES,
    MARK,
    SOURCE,
    printed_methods,
    printed_rotation,
)
from benchmarks.results import Results
from benchmarks.shape_pairs import LEFT_OUT
from benchmarks.sheet import Sheet
from benchmarks.summary import Cell, Summary, cells, rows_by_method


def result_sheets(results: Results) -> list[Sheet]:
    """An overview of every group, then all figures of every cell."""
    found = cells(results)
    groups = list(dict.fromkeys(cell.group for cell in found))
    overviews = [
        sheet
        for group in groups
        for sheet in _overviews(results, [cell for cell in found if cell.group == group])
    ]
    details = [
        _details(results, [cell for cell in found if (cell.group, cell.turn) == (group, turn)])
        for group in groups
        for turn in dict.fromkeys(cell.turn for cell in found if cell.group == group)
    ]
    return [*overviews, *details, *_calibration(results), *_printed(results)]


def _calibration(results: Results) -> list[Sheet]:
    """Whether stated probabilities hold, for methods that state any."""
    rows = []
    for method in with_probability(results):
        calibration = Calibration.of(results, method)
        rows.append(
            [
                method,
                str(len(calibration.stated)),
                percent(float(calibration.stated.mean())),
                percent(float(calibration.right.mean())),
                decimals(calibration.expected_error, 3),
                decimals(calibration.brier, 3),
                decimals(calibration.ranking, 3),
            ]
        )
    head = ["method", "pairs", "stated", "true", "calibration error", "Brier", "ranking"]
    note = (
        "All pairs together. Calibration error: between stated and true shares of successes, by "
        "tenths of probability. Ranking: how often a success is stated to be likelier than a "
        "failure (area under the ROC curve)."
    )
    return [Sheet("success probability", head, rows, note=note)] if rows else []


def _printed(results: Results) -> list[Sheet]:
    if results.benchmark == "rgbd":
        return [_printed_frames()]
    rows = ABLATIONS.get(str(results.settings.get("study")), ())
    if not rows:
        return []
    return [
        Sheet(
            "the paper's ablation, as printed",
            ["row", "rot. mean °", "std °"],
            [[f"{row.name} {MARK}", decimals(row.mean, 2), decimals(row.std, 2)] for row in rows],
            note=f"{ABLATION_SOURCE}; trained and tested on ModelNet40 at angles below 45°.",
        )
    ]


def _overviews(results: Results, found: Sequence[Cell]) -> list[Sheet]:
    """Methods down, cells across: mean rotation errors, and successes where surfaces are known."""
    group = found[0].group
    head = ["method", *(f"{_turn_title(cell.turn)} {cell.column}" for cell in found)]
    summaries = {
        method: [_summary(results, cell, method) for cell in found] for method in results.methods
    }
    shown = {method: row for method, row in summaries.items() if any(row)}
    errors = [
        [method, *(decimals(s.rotation_mean, 2) if s else "–" for s in row)]
        for method, row in shown.items()
    ]
    successes = [
        [method, *(percent(s.adds_success) if s else "–" for s in row)]
        for method, row in shown.items()
    ]
    printed = _printed_rows(found) if results.settings.get("protocol") == "paper" else []
    source = f"{MARK}: {SOURCE}, on ModelNet40." if printed else ""
    sheets = [
        Sheet(
            f"{group}: mean rotation error in degrees",
            head,
            errors + printed,
            note=" ".join(filter(None, [_left_out(results), source])),
        )
    ]
    if any(s is not None and s.adds_success is not None for row in shown.values() for s in row):
        sheets.append(Sheet(f"{group}: ADD-S < {ADDS_SUCCESS}", head, successes))
    return sheets


def _left_out(results: Results) -> str:
    count = sum(shape["group"] == LEFT_OUT for shape in results.shapes)
    return f"{count} symmetric shapes on the way were left out." if count else ""


def _printed_rows(found: Sequence[Cell]) -> list[list[str]]:
    rows = []
    for method in printed_methods():
        figures = [printed_rotation(method, cell.turn, cell.column) for cell in found]
        if any(figure is not None for figure in figures):
            rows.append([f"{method} {MARK}", *(decimals(figure, 2) for figure in figures)])
    return rows


def _printed_frames() -> Sheet:
    return Sheet(
        "ETH3D, as printed",
        ["method", "rot. mean °", "std °", "trans. mean m", "std m"],
        [
            [
                f"{row.method} {MARK}",
                decimals(row.rotation_mean, 2),
                decimals(row.rotation_std, 2),
                decimals(row.translation_mean, 2),
                decimals(row.translation_std, 2),
            ]
            for row in FRAMES
        ],
        note=f"{SOURCE}; other frames than those above, 10° extra rotation.",
    )


def _details(results: Results, found: Sequence[Cell]) -> Sheet:
    figures = figures_of(results.benchmark)
    rows = [
        [cell.column, method, *(figure.text(Summary.of(answers)) for figure in figures)]
        for cell in found
        for method, answers in rows_by_method(results, cell).items()
    ]
    return Sheet(
        f"{found[0].group}, {_turn_title(found[0].turn)}",
        ["column", "method", *(figure.title for figure in figures)],
        rows,
        labels=2,
    )


def _summary(results: Results, cell: Cell, method: str) -> Summary | None:
    answers = rows_by_method(results, cell).get(method)
    return Summary.of(answers) if answers else None


def _turn_title(turn: str) -> str:
    if turn == "so3":
        return "any rotation"
    return turn if turn.startswith("gap") else f"{turn}°"
