"""The engine without Ray: processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait

from app.batch.shard import Shard
from app.batch.worker import BatchWork, ShardDone, ShardWorker
from model.exceptions import EquivAlignError

_PATIENCE = 5
_THREADS = "OMP_NUM_THREADS"


class WorkersDieError(EquivAlignError):
    """Workers die faster than they finish anything."""


def run_in_processes(shards: Sequence[Shard], work: BatchWork, workers: int) -> Iterator[ShardDone]:
    """Register shards in so many processes; what a dying one had begun is begun anew.

    Raises:
        WorkersDieError: again and again, without one shard being finished.
        StorageError: the results can't be written.
    """
    waiting = {shard.name: shard for shard in shards}
    failures = 0
    while waiting:
        try:
            for done in _until_one_dies([*waiting.values()], work, workers):
                del waiting[done.name]
                failures = 0
                yield done
        except BrokenProcessPool:
            failures += 1
            if failures == _PATIENCE:
                raise WorkersDieError(
                    f"the workers died {failures} times without finishing a shard",
                    field="workers",
                    value=workers,
                    mend="see what ended them (the kernel's log, when memory is short), and run "
                    "fewer workers",
                ) from None


def _until_one_dies(shards: Sequence[Shard], work: BatchWork, workers: int) -> Iterator[ShardDone]:
    pool = ProcessPoolExecutor(
        min(workers, len(shards)), multiprocessing.get_context("spawn"), _begin, (work,)
    )
    try:
        with _one_thread_each():
            running = [pool.submit(_run, shard) for shard in shards]
        for future in as_completed(running):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Let processes that are started meanwhile compute with one thread, as Ray does."""
    before = os.environ.get(_THREADS)
    os.environ[_THREADS] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_THREADS]
        else:
            os.environ[_THREADS] = before


_worker: ShardWorker


def _begin(work: BatchWork) -> None:
    global _worker
    # An interrupt ends the workers at once and silently; what they had begun is begun anew.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    threading.Thread(target=_end_with_the_driver, daemon=True).start()
    _worker = ShardWorker(work)


def _end_with_the_driver() -> None:
    """A killed driver can't tell its workers to stop, and they would wait for work for ever."""
    driver = multiprocessing.parent_process()
    assert driver is not None
    wait([driver.sentinel])
    os._exit(1)


def _run(shard: Shard) -> ShardDone:
    return _worker(shard)
