"""The engine on Ray: ``map_batches`` of Ray Data with an actor that loads the artifact once."""

from __future__ import annotations

import logging
import os
import pickle
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import numpy as np

from app.batch.shard import Shard
from app.batch.worker import BatchWork, ShardDone, ShardWorker
from model.exceptions import EquivAlignError

# The workers write their results themselves; what goes through Ray's memory are lists of rows.
_OBJECT_STORE_BYTES = 256 * 2**20
_PATIENCE_SECONDS = 10.0


class RayFailedError(EquivAlignError):
    """Ray can't carry out the batch."""


def ray_is_installed() -> bool:
    """Whether this engine can be chosen."""
    return find_spec("ray") is not None


def run_on_ray(
    shards: Sequence[Shard], work: BatchWork, workers: int, address: str | None
) -> Iterator[ShardDone]:
    """Register shards on Ray; it begins anew what a dying worker or machine had begun.

    Args:
        shards: to register.
        work: what to do, and where.
        workers: actors, of one core each.
        address: of a cluster; None starts Ray on this machine for the time of the batch.

    Raises:
        EquivAlignError: what a worker refuses, as when it can't write its results.
        RayFailedError: Ray itself failed.
    """
    ray = _started(workers, address)
    try:
        documents = [{"shard": pickle.dumps(shard)} for shard in shards]
        dataset = ray.data.from_items(documents, override_num_blocks=len(documents))
        done = dataset.map_batches(
            _ShardActor,
            fn_constructor_args=(work,),
            compute=ray.data.ActorPoolStrategy(size=min(workers, len(shards))),
            batch_size=1,
            num_cpus=1,
        )
        for row in done.iter_rows():
            told = pickle.loads(row["told"])
            if isinstance(told, EquivAlignError):
                raise told
            yield told
    except ray.exceptions.RayError as error:
        raise RayFailedError(
            f"Ray gave the batch up: {type(error).__name__}",
            field="engine",
            value="ray",
            mend="Ray's logs, in /tmp/ray/session_latest, tell why; the same command goes on",
        ) from error
    finally:
        ray.shutdown()


class _ShardActor:
    """A ShardWorker as Ray Data calls it.

    What it refuses it returns: an exception would arrive wrapped in those of Ray.
    """

    def __init__(self, work: BatchWork) -> None:
        self._worker: ShardWorker | EquivAlignError
        try:
            self._worker = ShardWorker(work)
        except EquivAlignError as error:
            self._worker = error

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        told = [pickle.dumps(self._told(pickle.loads(shard))) for shard in batch["shard"]]
        return {"told": np.array(told, dtype=object)}

    def _told(self, shard: Shard) -> ShardDone | EquivAlignError:
        if isinstance(self._worker, EquivAlignError):
            return self._worker
        try:
            return self._worker(shard)
        except EquivAlignError as error:
            return error


def _started(workers: int, address: str | None) -> Any:
    """Ray, connected or started, without the dashboard, usage reports and the chatter of both."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # What fails is raised; its log is in the session's folder.
    os.environ.setdefault("RAY_BACKEND_LOG_LEVEL", "fatal")
    import ray

    own: dict[str, Any] = {
        "num_cpus": workers,
        "object_store_memory": _OBJECT_STORE_BYTES,
        "include_dashboard": False,
    }
    try:
        _knock(address)
        with _without_stderr():
            ray.init(
                address=address or "local",
                log_to_driver=False,
                logging_level=logging.CRITICAL,
                **({} if address else own),
            )
    except (OSError, RuntimeError, ValueError) as error:
        raise RayFailedError(
            f"can't reach or start Ray: {' '.join(str(error).split())}",
            field="address",
            value=address or "this machine",
            mend="give the address of a running cluster, or leave it out",
        ) from error
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    context.print_on_execution_start = False
    logging.getLogger("ray.data").setLevel(logging.CRITICAL)
    return ray


def _knock(address: str | None) -> None:
    """See whether anybody listens at ``host:port``; Ray would wait for long.

    Raises:
        OSError: nobody does.
    """
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if port.isdecimal():
        socket.create_connection((host, int(port)), _PATIENCE_SECONDS).close()


@contextmanager
def _without_stderr() -> Iterator[None]:
    """Ray's core tells, below Python, that its log level was set."""
    sys.stderr.flush()
    before, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
        os.close(nowhere)
