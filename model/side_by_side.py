"""Parts of one registration at once, where there is more than one core for it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import count
from typing import Any, TypeVar

import torch

Given = TypeVar("Given")
Made = TypeVar("Made")
Other = TypeVar("Other")


def side_by_side(function: Callable[[Given], Made], items: Iterable[Given]) -> list[Made]:
    """``[function(item) for item in items]``, in as many threads as PyTorch may use.

    ``torch.set_num_threads`` sets how many those are; compiled loops and matrix products give the
    interpreter's lock away meanwhile. The results don't depend on it. The calling thread works,
    too, so a call within another one comes to its end even when every other thread is busy.
    """
    waiting = list(items)
    helpers = min(torch.get_num_threads(), len(waiting)) - 1
    if helpers < 1:
        return [function(item) for item in waiting]
    made: list[Any] = [None] * len(waiting)
    turns = count()

    def work() -> None:
        while (turn := next(turns)) < len(waiting):
            made[turn] = function(waiting[turn])

    others = [_helpers().submit(work) for _ in range(helpers)]
    work()
    for other in others:
        if not other.cancel():
            other.result()
    return made


def run_together(first: Callable[[], Made], second: Callable[[], Other]) -> tuple[Made, Other]:
    """``first(), second()``, at once where there are two threads."""
    if torch.get_num_threads() < 2:
        return first(), second()
    other = _helpers().submit(second)
    made = first()
    return made, second() if other.cancel() else other.result()


@cache
def _helpers() -> ThreadPoolExecutor:
    """Threads that live as long as the process: to start one takes longer than many an item."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="side-by-side")


# A forked child has no threads but the one that forked.
os.register_at_fork(after_in_child=_helpers.cache_clear)
