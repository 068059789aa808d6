"""What every worker does, whichever engine runs it: register a shard and write its results."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from http import HTTPStatus
from time import perf_counter

import torch

from app.batch.manifest import ManifestRow
from app.batch.pair import PairRegistrar
from app.batch.result_table import Record, record
from app.batch.results import Results
from app.batch.shard import Shard
from app.schemas import Problem
from model import Registrar

# Workers that die at a shard may have been killed for another reason; one that kills twice is
# watched pair by pair.
_TRUSTED_ATTEMPTS = 2


@dataclass(frozen=True, slots=True)
class BatchWork:
    """What a worker has to know.

    Attributes:
        artifact: directory or name; None for the shipped one.
        digest: of the artifact.
        folder: what relative paths of the manifest are relative to.
        out: address of the results.
    """

    artifact: str | None
    digest: str
    folder: str
    out: str

    def pair_registrar(self) -> PairRegistrar:
        """Load the artifact, to be used by one thread of this process.

        Raises:
            ArtifactError: there is none, or it is broken.
        """
        torch.set_num_threads(1)
        return PairRegistrar(Registrar.load(self.artifact), self.digest, self.folder)


@dataclass(frozen=True, slots=True)
class ShardDone:
    """What the driver hears of a finished shard.

    Attributes:
        name: of its file.
        pairs: in it.
        errors: pairs with an error.
        seconds: that the worker took.
    """

    name: str
    pairs: int
    errors: int
    seconds: float


class ShardWorker:
    """Registers shards with an artifact that is loaded once.

    Args:
        work: what to do, and where.
    """

    def __init__(self, work: BatchWork) -> None:
        self._work = work
        self._results = Results.at(work.out)
        self._register = work.pair_registrar()

    def __call__(self, shard: Shard) -> ShardDone:
        """Register a shard and write it, unless it is written already.

        Raises:
            StorageError: the results can't be written.
        """
        started = perf_counter()
        if self._results.has(shard):
            return ShardDone(shard.name, len(shard.rows), 0, 0.0)
        if self._results.begin(shard) < _TRUSTED_ATTEMPTS:
            records = [self._register(row) for row in shard.rows]
        else:
            records = list(_one_by_one(self._work, shard))
        self._results.write(shard, records)
        self._results.end(shard)
        errors = sum(told["error"] is not None for told in records)
        return ShardDone(shard.name, len(records), errors, perf_counter() - started)


def artifact_digest(registrar: Registrar) -> str:
    """Tells an artifact, with its settings, from others."""
    said = json.dumps(registrar.summary, sort_keys=True, default=str)
    return hashlib.sha256(said.encode()).hexdigest()[:16]


def _one_by_one(work: BatchWork, shard: Shard) -> Iterator[Record]:
    """Register in a process apart, so that a pair that ends its process ends only that."""
    waiting = list(zip(shard.rows, shard.digests, strict=True))
    while waiting:
        with ProcessPoolExecutor(
            1, multiprocessing.get_context("spawn"), _begin_alone, (work,)
        ) as pool:
            try:
                while waiting:
                    yield pool.submit(_register_alone, waiting[0][0]).result()
                    waiting.pop(0)
            except BrokenProcessPool:
                row, digest = waiting.pop(0)
                yield record(row, digest, "", problem=_process_died())


_alone: PairRegistrar


def _begin_alone(work: BatchWork) -> None:
    global _alone
    _alone = work.pair_registrar()


def _register_alone(row: ManifestRow) -> Record:
    return _alone(row)


def _process_died() -> Problem:
    return Problem(
        type="urn:equivalign:problem:worker-died",
        title="The process that registered the pair died",
        status=HTTPStatus.INTERNAL_SERVER_ERROR,
        detail="every process that registered this pair was ended by the system, the last one "
        "with this pair alone",
        mend="most often its clouds are too large for the worker's memory: thin them out, or run "
        "fewer workers on a machine",
    )
