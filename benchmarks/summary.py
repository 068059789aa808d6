"""Figures over many rows: what a table prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.pose_error import ADDS_SUCCESS
from benchmarks.results import Results, Row
from benchmarks.shape_pairs import SYMMETRIC

ALL_SEQUENCES = "all sequences"


@dataclass(frozen=True, slots=True)
class Summary:
    """One method in one cell of a benchmark; angles in degrees.

    Attributes:
        pairs: how many.
        rotation_mean: of the geodesic error.
        rotation_median: of it.
        rotation_std: of it.
        below_5: share of pairs with an error below 5°.
        below_1: share below 1°.
        se3_log_mean: of the norm of the SE(3) logarithm.
        translation_mean: of the origin's.
        translation_std: of it.
        translation_median: of it.
        centroid_mean: of the centroid's.
        centroid_std: of it.
        centroid_median: of it.
        adds_mean: of ADD-S; None where there is no surface.
        adds_success: share of pairs with ADD-S below 0.03.
        seconds_median: a pair; None where nobody measured it.
    """

    pairs: int
    rotation_mean: float
    rotation_median: float
    rotation_std: float
    below_5: float
    below_1: float
    se3_log_mean: float
    translation_mean: float
    translation_std: float
    translation_median: float
    centroid_mean: float
    centroid_std: float
    centroid_median: float
    adds_mean: float | None
    adds_success: float | None
    seconds_median: float | None

    @classmethod
    def of(cls, rows: Sequence[Row]) -> Summary:
        """Sum up at least one row."""
        rotation = np.array([row.error.rotation_deg for row in rows])
        origin = np.array([row.error.translation for row in rows])
        centroid = np.array([row.error.translation_centroid for row in rows])
        surfaces = np.array([row.error.adds for row in rows if row.error.adds is not None])
        seconds = [row.seconds for row in rows if row.seconds is not None]
        return cls(
            pairs=len(rows),
            rotation_mean=float(rotation.mean()),
            rotation_median=float(np.median(rotation)),
            rotation_std=float(rotation.std()),
            below_5=float((rotation < 5.0).mean()),
            below_1=float((rotation < 1.0).mean()),
            se3_log_mean=float(np.mean([row.error.se3_log for row in rows])),
            translation_mean=float(origin.mean()),
            translation_std=float(origin.std()),
            translation_median=float(np.median(origin)),
            centroid_mean=float(centroid.mean()),
            centroid_std=float(centroid.std()),
            centroid_median=float(np.median(centroid)),
            adds_mean=float(surfaces.mean()) if len(surfaces) else None,
            adds_success=float((surfaces < ADDS_SUCCESS).mean()) if len(surfaces) else None,
            seconds_median=float(np.median(seconds)) if seconds else None,
        )


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """Pairs that are summed up together."""

    group: str
    turn: str
    column: str


def cells(results: Results) -> list[Cell]:
    """The cells of the list, in its order, group by group; then all sequences together."""
    entries = [pair.entry for pair in results.pairs.values()]
    # Symmetric shapes come last, wherever the first of them was met.
    groups = sorted(dict.fromkeys(e.group for e in entries), key=lambda group: group == SYMMETRIC)
    if results.benchmark == "rgbd" and len(groups) > 1:
        groups.append(ALL_SEQUENCES)
    found = dict.fromkeys(
        Cell(group, entry.turn, entry.column)
        for group in groups
        for entry in entries
        if group in (entry.group, ALL_SEQUENCES)
    )
    turns = list(dict.fromkeys(cell.turn for cell in found))
    return sorted(found, key=lambda cell: (groups.index(cell.group), turns.index(cell.turn)))


def rows_by_method(results: Results, cell: Cell) -> dict[str, list[Row]]:
    """The rows of one cell, for each method that has any, in the methods' order."""
    inside = [
        name
        for name, pair in results.pairs.items()
        if (pair.entry.turn, pair.entry.column) == (cell.turn, cell.column)
        and cell.group in (pair.entry.group, ALL_SEQUENCES)
    ]
    found = {
        method: [results.rows[name, method] for name in inside if (name, method) in results.rows]
        for method in results.methods
    }
    return {method: rows for method, rows in found.items() if rows}
