"""The simulation of a batch: its limits are those that one can work out by hand."""

from __future__ import annotations

import pytest

from benchmarks.scaling_model import drawn_shards, simulated


def test_one_worker_works_all_the_time() -> None:
    found = simulated([1.0, 2.0, 3.0], 1, 0.0)
    assert found.seconds == 6.0
    assert found.efficiency == 1.0


def test_equal_shards_are_shared_evenly() -> None:
    assert simulated([1.0] * 40, 4, 0.0).seconds == pytest.approx(10.0)
    # The last shard has nobody beside it.
    assert simulated([1.0] * 41, 4, 0.0).seconds == pytest.approx(11.0)


def test_the_driver_bounds_how_many_shards_begin_in_a_second() -> None:
    """Ten a second, however many workers there are."""
    found = simulated([1.0] * 1000, 500, 0.1)
    assert found.seconds == pytest.approx(101.0, rel=0.01)
    assert simulated([1.0] * 1000, 10, 0.0001).efficiency > 0.99


def test_shards_are_drawn_from_what_was_measured() -> None:
    shards = drawn_shards([0.1, 0.3], 1000, 64, seed=1)
    assert len(shards) == 16
    assert sum(shards) == pytest.approx(200.0, rel=0.05)
    assert shards == drawn_shards([0.1, 0.3], 1000, 64, seed=1)
    assert max(shards[:-1]) < 64 * 0.3
