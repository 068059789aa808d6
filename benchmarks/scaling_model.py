"""A batch on any number of workers, in simulation: from what shards cost and what the driver does.

Workers take shards one after another from one driver, which gives out one at a time; the batch
ends with the last worker. What isn't in it: workers that hinder each other, storage that is slow
for many, machines that are lost.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Growth:
    """A batch on so many workers.

    Attributes:
        workers: of one core each.
        seconds: from the first worker's start of work to the last one's end.
        efficiency: share of the workers' time that was work.
    """

    workers: int
    seconds: float
    efficiency: float


def simulated(shard_seconds: Sequence[float], workers: int, dispatch_seconds: float) -> Growth:
    """Give out shards in their order to whoever is free first.

    Args:
        shard_seconds: what each shard takes a worker.
        workers: of one core each.
        dispatch_seconds: that the driver needs to give one out and hear of its end.
    """
    free = [0.0] * workers
    driver = end = 0.0
    for seconds in shard_seconds:
        driver = max(driver, heapq.heappop(free)) + dispatch_seconds
        done = driver + seconds
        heapq.heappush(free, done)
        end = max(end, done)
    return Growth(workers, end, float(sum(shard_seconds)) / (workers * end))


def drawn_shards(row_seconds: Sequence[float], pairs: int, size: int, seed: int = 0) -> list[float]:
    """What the shards of a larger batch of such pairs take.

    Args:
        row_seconds: measured, of single pairs.
        pairs: in the larger batch.
        size: of a shard.
        seed: of the draw, with replacement.
    """
    generator = np.random.default_rng(seed)
    drawn = generator.choice(np.asarray(row_seconds), pairs)
    return [float(part.sum()) for part in np.split(drawn, range(size, pairs, size))]
