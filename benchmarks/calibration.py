"""Whether a stated probability of success is as often right as it says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.pair import FloatArray
from benchmarks.pose_error import ADDS_SUCCESS
from benchmarks.results import Results, Row

STATED = "success_probability"
ROTATION_SUCCESS_DEG = 5.0
_BINS = 10


@dataclass(frozen=True, slots=True)
class Calibration:
    """Stated probabilities and what came true.

    Attributes:
        stated: (P,) probabilities.
        right: (P,) whether the pose was a success.
    """

    stated: FloatArray
    right: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, results: Results, method: str) -> Calibration:
        """All answers of a method that state a probability; it has at least one."""
        rows = _stating(results, method)
        return cls(
            np.array([row.findings[STATED] for row in rows], dtype=np.float64),
            np.array([succeeded(row) for row in rows]),
        )

    def bins(self) -> list[tuple[float, float, int]]:
        """Mean stated probability, share of successes and count, for each tenth that is used."""
        number = np.minimum((self.stated * _BINS).astype(int), _BINS - 1)
        return [
            (
                float(self.stated[number == b].mean()),
                float(self.right[number == b].mean()),
                int((number == b).sum()),
            )
            for b in np.unique(number)
        ]

    @property
    def expected_error(self) -> float:
        """Mean distance between the stated and the true share of a tenth, by its count."""
        total = len(self.stated)
        return sum(count * abs(stated - right) for stated, right, count in self.bins()) / total

    @property
    def brier(self) -> float:
        """Mean square of stated minus true; 0.25 is what always saying one half scores."""
        return float(np.mean((self.stated - self.right) ** 2))

    @property
    def ranking(self) -> float | None:
        """How often a success is stated to be likelier than a failure; None without both."""
        good, bad = self.stated[self.right], self.stated[~self.right]
        if len(good) == 0 or len(bad) == 0:
            return None
        above = (good[:, None] > bad).mean() + 0.5 * (good[:, None] == bad).mean()
        return float(above)


def with_probability(results: Results) -> list[str]:
    """Methods that state a probability for any of their poses."""
    return [method for method in results.methods if _stating(results, method)]


def succeeded(row: Row) -> bool:
    """ADD-S below 0.03; where no surface is known, a rotation error below 5°."""
    if row.error.adds is not None:
        return row.error.adds < ADDS_SUCCESS
    return row.error.rotation_deg < ROTATION_SUCCESS_DEG


def _stating(results: Results, method: str) -> Sequence[Row]:
    return [row for row in results.rows.values() if row.method == method and STATED in row.findings]
