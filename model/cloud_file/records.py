"""Points as runs of equal records, which is how both PLY and PCD keep them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.cloud_file.content import FileContent
from model.cloud_file.text import numbers
from model.exceptions import UnreadableFileError

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Records:
    """A run of equal records in a file: one a point, each with named fields in this order."""

    count: int
    fields: list[tuple[str, np.dtype[Any]]]

    @property
    def size(self) -> int:
        """Bytes of one record."""
        return sum(dtype.itemsize for _, dtype in self.fields)

    @property
    def columns(self) -> int:
        """Numbers in one record."""
        return sum(width(dtype) for _, dtype in self.fields)


def width(dtype: np.dtype[Any]) -> int:
    """How many numbers a field holds."""
    return int(np.prod(dtype.shape, dtype=int))


def record_count(text: str) -> int:
    """A header's number of records.

    Raises:
        ValueError: not a natural number.
    """
    if (count := int(text)) < 0:
        raise ValueError(text)
    return count


def axis_offsets(
    file: FileContent, records: Records, step: Callable[[np.dtype[Any]], int]
) -> list[int]:
    """Where x, y and z begin in a record, in the unit that ``step`` counts."""
    names = [name for name, _ in records.fields]
    if any(names.count(axis) != 1 for axis in "xyz"):
        raise file.refuse(
            f"its points have no single x, y and z but {' '.join(names) or 'nothing'}"
        )
    if any(width(dtype) != 1 for name, dtype in records.fields if name in "xyz"):
        raise file.refuse("its x, y and z aren't single numbers")
    starts = np.cumsum([0, *(step(dtype) for _, dtype in records.fields)])
    return [int(starts[names.index(axis)]) for axis in "xyz"]


def points_in_text(file: FileContent, records: Records, rows: list[str]) -> FloatArray:
    """x, y and z (N, 3) of records that are rows of text."""
    columns = axis_offsets(file, records, width)
    file.allow_points(records.count)
    values = numbers(file, rows[: records.count], columns=None)
    if len(values) < records.count:
        raise truncated(file, records, len(values))
    if records.count and values.shape[1] < records.columns:
        raise file.refuse("its rows have fewer numbers than the header says")
    return values[:, columns]


def points_in_binary(file: FileContent, records: Records, offset: int) -> FloatArray:
    """x, y and z (N, 3) of records that are bytes from an offset on."""
    axes = np.dtype(
        {
            "names": list("xyz"),
            "formats": [dict(records.fields).get(axis, "f4") for axis in "xyz"],
            "offsets": axis_offsets(file, records, lambda dtype: dtype.itemsize),
            "itemsize": records.size,
        }
    )
    file.allow_points(records.count)
    whole = (len(file.data) - offset) // records.size
    if whole < records.count:
        raise truncated(file, records, whole)
    rows = np.frombuffer(file.data, axes, records.count, offset)
    return np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1)


def truncated(file: FileContent, records: Records, found: int) -> UnreadableFileError:
    """The error to raise for a file with fewer records than it promises."""
    return file.refuse(
        f"the file is truncated: its header promises {records.count} points and it holds {found}"
    )
