"""Rows of numbers in text, and XYZ files, which are nothing else."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.cloud_file.content import FileContent

FloatArray = npt.NDArray[np.float64]


def read_xyz(file: FileContent) -> FloatArray:
    """(N, 3), the first three columns."""
    return numbers(file, file.text().splitlines(), columns=range(3))


def write_xyz(path: Path, points: FloatArray) -> None:
    """Write points (N, 3) with every digit of float64."""
    np.savetxt(path, points, fmt="%.17g")


def numbers(file: FileContent, rows: Iterable[str], columns: Iterable[int] | None) -> FloatArray:
    """Rows of text as numbers (N, columns); all columns, of equal number, when not told which.

    Raises:
        UnreadableFileError: something else stands among the numbers.
    """
    filled = [row for row in rows if row.split("#", 1)[0].strip()]
    if not filled:
        return np.empty((0, 3))
    try:
        return np.loadtxt(filled, usecols=None if columns is None else tuple(columns), ndmin=2)
    except ValueError as error:
        raise file.refuse(f"the file isn't rows of numbers: {error}") from error
