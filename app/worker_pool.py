"""The threads that do the work, and the bounded queue before them."""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field, replace
from time import monotonic
from typing import Any, TypeVar

import torch
from anyio import to_thread
from fastapi import Request
from starlette.requests import ClientDisconnect

from app.cores import usable_cores
from app.metrics import ServiceMetrics
from app.refusals import DeadlineExceededError, OverloadedError

_T = TypeVar("_T")

# Until the first job has told how long one takes.
_FIRST_GUESS_SECONDS = 1.0
_LONGEST_RETRY_SECONDS = 60
_SMOOTHING = 0.2


@dataclass(slots=True)
class Job:
    """A piece of work that has been let in.

    Attributes:
        deadline: seconds from its arrival until it has to end.
        arrived: on the monotonic clock.
        cancel: set when nobody waits for it any more.
        facts: what the request's log line shall tell.
    """

    deadline: float
    arrived: float = field(default_factory=monotonic)
    cancel: threading.Event = field(default_factory=threading.Event)
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def remaining(self) -> float:
        """Seconds until the deadline.

        Raises:
            DeadlineExceededError: none are left.
        """
        left = self.arrived + self.deadline - monotonic()
        if left <= 0.0:
            raise DeadlineExceededError(self.deadline)
        return left

    def shorten(self, deadline: float) -> None:
        """Let it end earlier; nobody may let it end later."""
        self.deadline = min(self.deadline, deadline)

    def part(self) -> Job:
        """The same job for a part of the work, which may have a deadline of its own."""
        return replace(self)


class WorkerPool:
    """Lets in as much work as it can do in time, and runs it beside the event loop.

    Args:
        workers: jobs that run at the same time; each computes with its share of the cores.
        queue: jobs that may wait.
        metrics: told of the queue and of refusals.
    """

    def __init__(self, workers: int, queue: int, metrics: ServiceMetrics) -> None:
        self._workers = workers
        self._room = workers + queue
        self._metrics = metrics
        self._inside = 0
        self._mean_seconds = _FIRST_GUESS_SECONDS
        self._executor: ThreadPoolExecutor | None = None

    @asynccontextmanager
    async def open(self) -> AsyncIterator[None]:
        """Have threads for the time of the block; it ends when their jobs have ended."""
        share = max(1, usable_cores() // self._workers)
        self._executor = ThreadPoolExecutor(
            self._workers, "registration", initializer=torch.set_num_threads, initargs=(share,)
        )
        try:
            yield
        finally:
            await to_thread.run_sync(self._executor.shutdown)

    @contextmanager
    def admit(self, deadline: float) -> Iterator[Job]:
        """A place in the queue for the time of the block.

        Raises:
            OverloadedError: the queue is full, or so long that the deadline would pass in it.
        """
        wait = self._mean_seconds * (self._inside + 1 - self._workers) / self._workers
        if self._inside >= self._room or wait > deadline:
            self._metrics.rejections.labels("queue-full").inc()
            raise OverloadedError(min(_LONGEST_RETRY_SECONDS, max(1, math.ceil(wait))))
        self._inside += 1
        self._watch_queue()
        try:
            yield Job(deadline)
        finally:
            self._inside -= 1
            self._watch_queue()

    async def run(self, job: Job, request: Request, work: Callable[[], _T]) -> _T:
        """Run a job's work in a thread; the body of the request must have been read.

        Raises:
            ClientDisconnect: the caller went away; the work is told to stop.
        """
        assert self._executor is not None, "the pool hasn't been opened"
        future = self._executor.submit(self._timed, job, work)
        running = asyncio.wrap_future(future)
        gone = asyncio.create_task(_disconnected(request))
        either: set[asyncio.Future[Any]] = {running, gone}
        try:
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not running.done():
                self._metrics.rejections.labels("disconnected").inc()
                raise ClientDisconnect
            return running.result()
        finally:
            gone.cancel()
            if not running.done():
                job.cancel.set()
                if not future.cancel():
                    # Its place is free when its thread is.
                    await asyncio.wait({running})
                    running.exception()

    def _timed(self, job: Job, work: Callable[[], _T]) -> _T:
        if job.cancel.is_set():
            raise ClientDisconnect
        started = monotonic()
        try:
            return work()
        finally:
            seconds = monotonic() - started
            self._mean_seconds += _SMOOTHING * (seconds - self._mean_seconds)

    def _watch_queue(self) -> None:
        self._metrics.queue_depth.set(max(0, self._inside - self._workers))
        self._metrics.jobs.set(min(self._inside, self._workers))


async def _disconnected(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
