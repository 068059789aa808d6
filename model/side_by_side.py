"""Two halves of one registration at once, where there is more than one core for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch

Given = TypeVar("Given")
Made = TypeVar("Made")
Other = TypeVar("Other")


def side_by_side(function: Callable[[Given], Made], items: Iterable[Given]) -> list[Made]:
    """``[function(item) for item in items]``, in as many threads as PyTorch may use.

    ``torch.set_num_threads`` sets how many those are; compiled loops and matrix products give the
    interpreter's lock away meanwhile. The results don't depend on it.
    """
    waiting = list(items)
    threads = min(torch.get_num_threads(), len(waiting))
    if threads < 2:
        return [function(item) for item in waiting]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, waiting))


def run_together(first: Callable[[], Made], second: Callable[[], Other]) -> tuple[Made, Other]:
    """``first(), second()``, at once where there are two threads."""
    if torch.get_num_threads() < 2:
        return first(), second()
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(second)
        return first(), other.result()
