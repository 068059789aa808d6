"""Loops over near points, compiled when first called and kept on disk for the next process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays; it runs without the interpreter's lock."""
    return cast(
        Function, njit(cache=True, nogil=True, fastmath=True, error_model="numpy")(function)
    )
