"""The columns of the tables: which figure, and how it is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.summary import Summary


@dataclass(frozen=True, slots=True)
class Figure:
    """A column of figures.

    Attributes:
        title: its head.
        text: how one is written.
    """

    title: str
    text: Callable[[Summary], str]


def percent(share: float | None) -> str:
    """A share in whole per cent, with a decimal close to all of it."""
    if share is None:
        return "–"
    return f"{100.0 * share:.1f} %" if 0.95 < share < 1.0 else f"{100.0 * share:.0f} %"


def decimals(value: float | None, count: int) -> str:
    """So many decimals; a dash where nobody measured."""
    return "–" if value is None else f"{value:.{count}f}"


_ROTATION = (
    Figure("pairs", lambda s: str(s.pairs)),
    Figure("rot. mean °", lambda s: decimals(s.rotation_mean, 2)),
    Figure("median °", lambda s: decimals(s.rotation_median, 2)),
    Figure("std °", lambda s: decimals(s.rotation_std, 2)),
    Figure("< 5°", lambda s: percent(s.below_5)),
    Figure("< 1°", lambda s: percent(s.below_1)),
)
_SECONDS = Figure("s/pair", lambda s: decimals(s.seconds_median, 3))

_OBJECTS = (
    *_ROTATION,
    Figure("‖log‖ mean", lambda s: decimals(s.se3_log_mean, 3)),
    Figure("trans. mean", lambda s: decimals(s.translation_mean, 4)),
    Figure("ADD-S mean", lambda s: decimals(s.adds_mean, 4)),
    Figure("ADD-S < 0.03", lambda s: percent(s.adds_success)),
    _SECONDS,
)
_FRAMES = (
    *_ROTATION,
    Figure("centroid mean m", lambda s: decimals(s.centroid_mean, 4)),
    Figure("median", lambda s: decimals(s.centroid_median, 4)),
    Figure("std", lambda s: decimals(s.centroid_std, 4)),
    Figure("origin mean m", lambda s: decimals(s.translation_mean, 4)),
    Figure("median", lambda s: decimals(s.translation_median, 4)),
    Figure("std", lambda s: decimals(s.translation_std, 4)),
    _SECONDS,
)


def figures_of(benchmark: str) -> Sequence[Figure]:
    """Those of ``objects``, ``ablations`` or ``rgbd``."""
    return _FRAMES if benchmark == "rgbd" else _OBJECTS
