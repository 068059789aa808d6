"""The few figures of a results file that stand in the README."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.figures import decimals, percent
from benchmarks.printed import printed_rotation
from benchmarks.results import Results
from benchmarks.shape_pairs import ASYMMETRIC
from benchmarks.summary import ALL_SEQUENCES, Cell, Summary, cells, rows_by_method

METHODS = {
    "ours": "ours",
    "ransac": "FPFH + RANSAC + ICP",
    "ransac_3": "the same, best of 3",
    "fgr": "FPFH + FGR + ICP",
    "kiss_matcher": "KISS-Matcher + ICP",
    "icp": "ICP",
    "gicp": "GICP",
}
PAPER = "the paper (printed)"


@dataclass(frozen=True, slots=True)
class Headline:
    """One row of the README's table.

    Attributes:
        pairs: what was registered, and how many of them.
        figure: what was measured.
        texts: how each method's figure is written.
        best: those whose text is the best.
    """

    pairs: str
    figure: str
    texts: dict[str, str]
    best: list[str]


@dataclass(frozen=True, slots=True)
class _Figure:
    title: str
    value: Callable[[Summary], float | None]
    text: Callable[[float | None], str]
    larger_is_better: bool = False


_ROTATION = _Figure("mean rotation error, °", lambda s: s.rotation_mean, lambda v: decimals(v, 2))
_SUCCESS = _Figure("ADD-S < 0.03", lambda s: s.adds_success, percent, larger_is_better=True)
_BELOW_5 = _Figure("rotation error < 5°", lambda s: s.below_5, percent, larger_is_better=True)
_MILLIMETRES = _Figure(
    "mean error of the centroid, mm",
    lambda s: 1000.0 * s.centroid_mean,
    lambda v: decimals(v, 1),
)


def headlines_of(results: Results) -> list[Headline]:
    """The largest angle of ``paper``, every column of ``full`` and ``hard``, turned real frames.

    Args:
        results: of ``objects`` or ``rgbd``; others have none.
    """
    return [
        _headline(results, cell, figure)
        for cell in _chosen(results)
        for figure in _figures(results)
        if rows_by_method(results, cell)
    ]


def _chosen(results: Results) -> Sequence[Cell]:
    found = cells(results)
    if results.benchmark == "rgbd":
        turned = [cell for cell in found if cell.column.startswith("extra")]
        return [cell for cell in turned if cell.group == ALL_SEQUENCES] or turned
    if results.benchmark != "objects":
        return []
    asymmetric = [cell for cell in found if cell.group == ASYMMETRIC]
    if results.settings["protocol"] != "paper":
        return asymmetric
    largest = max((float(cell.turn) for cell in asymmetric), default=0.0)
    return [cell for cell in asymmetric if float(cell.turn) == largest]


def _figures(results: Results) -> Sequence[_Figure]:
    if results.benchmark == "rgbd":
        return [_ROTATION, _MILLIMETRES]
    return [{"paper": _ROTATION, "full": _BELOW_5, "hard": _SUCCESS}[results.settings["protocol"]]]


def _headline(results: Results, cell: Cell, figure: _Figure) -> Headline:
    rows = rows_by_method(results, cell)
    summaries = {name: Summary.of(rows[name]) for name in METHODS if name in rows}
    values = {name: figure.value(summary) for name, summary in summaries.items()}
    texts = {name: figure.text(value) for name, value in values.items()}
    known = {name: value for name, value in values.items() if value is not None}
    chosen = max if figure.larger_is_better else min
    leader = chosen(known, key=lambda name: known[name]) if known else None
    best = [name for name, text in texts.items() if leader and text == texts[leader]]
    if figure is _ROTATION and results.settings.get("protocol") == "paper":
        printed = printed_rotation("EquivAlign", cell.turn, cell.column)
        texts |= {} if printed is None else {PAPER: decimals(printed, 2)}
    count = max((summary.pairs for summary in summaries.values()), default=0)
    return Headline(_pairs(results, cell, count), figure.title, texts, best)


def _pairs(results: Results, cell: Cell, count: int) -> str:
    settings = results.settings
    if results.benchmark == "rgbd":
        return f"{cell.group}, {cell.turn}, turned by 10° more, {count} pairs"
    data = str(settings["data"]).removesuffix(".npz")
    turn = "any angle" if cell.turn == "so3" else f"{cell.turn}°"
    return f"{data}, {settings['protocol']}, {turn}, {cell.column}, {count} pairs"
