"""Parts of one registration at once, where there is more than one core for it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from itertools import count
from threading import Lock
from typing import Any, Generic, TypeVar

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
    other = Promise(second)
    return first(), other()


class Promise(Generic[Made]):
    """What another thread makes meanwhile, if one is free; or else whoever asks for it.

    Args:
        make: is called once.
    """

    def __init__(self, make: Callable[[], Made]) -> None:
        self._make = make
        self._asking = Lock()
        self._made: list[Made] = []
        several = torch.get_num_threads() > 1
        self._begun: Future[Made] | None = _helpers().submit(make) if several else None

    def __call__(self) -> Made:
        """Wait for it, or make it."""
        with self._asking:
            if not self._made:
                begun, self._begun = self._begun, None
                mine = begun is None or begun.cancel()
                self._made.append(self._make() if mine or begun is None else begun.result())
        return self._made[0]

    def help(self) -> None:
        """Make it here and now, unless another thread has begun."""
        begun = self._begun
        if begun is None or begun.cancel():
            self()


@cache
def _helpers() -> ThreadPoolExecutor:
    """Threads that live as long as the process: to start one takes longer than many an item.

    One core is left to whoever has the work done.
    """
    return ThreadPoolExecutor(max(1, (os.cpu_count() or 1) - 1), "side-by-side")


# A forked child has no threads but the one that forked.
os.register_at_fork(after_in_child=_helpers.cache_clear)
