"""The engine on Ray: ``map_batches`` of Ray Data with an actor that loads the artifact once."""

from __future__ import annotations

import logging
import os
import pickle
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from app.batch.shard import Shard
from app.batch.worker import BatchWork, ShardDone, ShardWorker
from model.exceptions import EquivAlignError

# The workers write their results themselves; what goes through Ray's memory are lists of rows.
_OBJECT_STORE_BYTES = 256 * 2**20


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
            yield ShardDone(**row)
    except ray.exceptions.RayError as error:
        raise _refusal(error) from error
    finally:
        ray.shutdown()


class _ShardActor:
    """A ShardWorker as Ray Data calls it."""

    def __init__(self, work: BatchWork) -> None:
        self._worker = ShardWorker(work)

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        done = [self._worker(pickle.loads(shard)) for shard in batch["shard"]]
        return {
            name: np.array([getattr(one, name) for one in done]) for name in ShardDone.__slots__
        }


def _refusal(error: BaseException) -> EquivAlignError:
    """What a worker refused, out of what Ray wraps around it; or that Ray itself failed."""
    inner: BaseException | None = error
    while inner is not None:
        told = getattr(inner, "cause", None)
        for candidate in (told, inner):
            if isinstance(candidate, EquivAlignError) and not hasattr(candidate, "cause"):
                return candidate
        inner = inner.__cause__
    return RayFailedError(
        f"Ray failed: {str(error).strip().splitlines()[-1]}",
        field="engine",
        value="ray",
        mend="run the same command again; the log is in Ray's session folder",
    )


def _started(workers: int, address: str | None) -> Any:
    """Ray, connected or started, without the dashboard, usage reports and the chatter of both."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # What fails is raised; its log is in the session's folder.
    os.environ.setdefault("RAY_BACKEND_LOG_LEVEL", "fatal")
    import ray

    own: dict[str, Any] = {"num_cpus": workers, "object_store_memory": _OBJECT_STORE_BYTES}
    ray.init(
        address=address or "local",
        include_dashboard=None if address else False,
        log_to_driver=False,
        logging_level=logging.ERROR,
        **({} if address else own),
    )
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    context.print_on_execution_start = False
    logging.getLogger("ray.data").setLevel(logging.ERROR)
    return ray
