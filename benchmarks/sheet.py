"""A table before it is drawn: on a terminal or in a document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table.

    Attributes:
        title: above it.
        head: one text a column.
        rows: as many texts each.
        labels: the first so many columns hold names, the others figures.
        note: below it, or nothing.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    labels: int = 1
    note: str = ""
