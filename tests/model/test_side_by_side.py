"""Work done by helpers is done once, by whoever is free."""

from __future__ import annotations

import os
import threading
import time

import pytest
import torch

from model.side_by_side import Promise, run_together, side_by_side


@pytest.fixture(params=[1, 2])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def test_a_promise_is_kept_once_for_everybody_who_asks(threads):
    made = []

    def make() -> int:
        time.sleep(0.02)
        made.append(threading.get_ident())
        return len(made)

    promise = Promise(make)
    answers: list[int] = []
    askers = [threading.Thread(target=lambda: answers.append(promise())) for _ in range(4)]
    for asker in askers:
        asker.start()
    for asker in askers:
        asker.join()
    assert answers == [1, 1, 1, 1]


def test_nothing_is_begun_ahead_by_a_single_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        made: list[int] = []
        Promise(lambda: made.append(1))
        time.sleep(0.02)
        assert made == []
    finally:
        torch.set_num_threads(before)


def test_who_helps_makes_what_nobody_has_begun(threads):
    hold, begun = threading.Event(), threading.Event()

    def busy() -> int:
        begun.set()
        hold.wait(5.0)
        return 1

    # As many as there can be helpers: the last promise waits behind them.
    others = [Promise(busy) for _ in range(os.cpu_count() or 1)] if threads > 1 else []
    makers: list[int] = []
    last = Promise(lambda: makers.append(threading.get_ident()))
    last.help()
    assert makers == [threading.get_ident()]
    if others:
        begun.wait(5.0)
        others[0].help()
    hold.set()
    assert [other() for other in others] == [1] * len(others)


def test_an_error_reaches_who_asks(threads):
    def fail() -> int:
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        Promise(fail)()
    with pytest.raises(ValueError, match="broken"):
        run_together(lambda: 1, fail)


def test_calls_within_calls_come_to_an_end_in_order(threads):
    def outer(i: int) -> list[int]:
        return side_by_side(lambda j: 10 * i + j, range(3))

    assert side_by_side(outer, range(4)) == [[10 * i + j for j in range(3)] for i in range(4)]
