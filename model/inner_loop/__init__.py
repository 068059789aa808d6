"""Inner loops, chosen by name: argmin over (h, ℓ) of d(f_X, f_hZ)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from model.exceptions import InvalidOptionError
from model.inner_loop.gradient import GradientLoop
from model.inner_loop.procrustes import ProcrustesLoop
from model.inner_loop.solution import InnerLoop, Solution, Step, Stop, never

INNER_LOOPS: dict[str, Callable[..., InnerLoop]] = {
    "procrustes": ProcrustesLoop,
    "gradient": GradientLoop,
}


def build_inner_loop(name: str, **settings: Any) -> InnerLoop:
    """Build an inner loop.

    Args:
        name: one of ``INNER_LOOPS``.
        settings: the loop's own attributes; the others keep their defaults.

    Raises:
        InvalidOptionError: no loop of this name, or a setting it doesn't have.
    """
    if name not in INNER_LOOPS:
        raise InvalidOptionError(
            "unknown solver",
            field="solver",
            value=name,
            mend=f"choose one of {', '.join(INNER_LOOPS)}",
        )
    try:
        return INNER_LOOPS[name](**settings)
    except TypeError as error:
        raise InvalidOptionError(
            f"{name} can't be built: {error}",
            field="solver",
            value=settings,
            mend="see the solver's attributes",
        ) from None


__all__ = [
    "INNER_LOOPS",
    "GradientLoop",
    "InnerLoop",
    "ProcrustesLoop",
    "Solution",
    "Step",
    "Stop",
    "build_inner_loop",
    "never",
]
