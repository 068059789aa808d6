"""Lists of words and numbers, as ETH3D and TUM keep them beside their images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.exceptions import UnreadableFileError

FloatArray = npt.NDArray[np.float64]

# In seconds; a frame's period is 33 ms.
SAME_TIME = 0.02


def read_rows(path: Path, columns: int) -> list[list[str]]:
    """The words of a list's rows, comments left out.

    Raises:
        UnreadableFileError: no such list, or a row with fewer words than ``columns``.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableFileError(
            "this list of the sequence can't be read",
            field="sequence",
            value=str(path),
            mend="give a folder in the layout of ETH3D or TUM",
        ) from error
    rows = [line.split() for line in text.splitlines() if line.strip() and line[0] != "#"]
    for number, row in enumerate(rows, start=1):
        if len(row) < columns:
            raise UnreadableFileError(
                f"row {number} has {len(row)} words instead of {columns}",
                field="sequence",
                value=str(path),
                mend="give every row all its columns",
            )
    return rows


def numbers_in(rows: list[list[str]], columns: slice, path: Path) -> FloatArray:
    """Some columns of a list as finite numbers (rows, columns).

    Raises:
        UnreadableFileError: something else than finite numbers.
    """
    try:
        numbers = np.array([row[columns] for row in rows], dtype=np.float64)
    except ValueError:
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise UnreadableFileError(
            "this list of the sequence holds something else than finite numbers",
            field="sequence",
            value=str(path),
            mend="give times in seconds and lengths in metres, as decimal numbers",
        )
    return numbers
