"""Loops over near points, compiled when first called and kept on disk for the next process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays; it runs without the interpreter's lock.

    What it calls is compiled into it. Else a process could take the callee's own code where
    another takes the caller's copy, which was optimised twice: sums would differ in the last digit
    between the process that compiled and those that load from disk.
    """
    compile_ = njit(cache=True, nogil=True, fastmath=True, error_model="numpy", forceinline=True)
    return cast(Function, compile_(function))
