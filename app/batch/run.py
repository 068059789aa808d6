"""A batch from the manifest to the summary."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Literal

import pyarrow.compute as pc

from app.batch.manifest import Manifest, read_manifest
from app.batch.on_ray import ray_is_installed, run_on_ray
from app.batch.processes import run_in_processes
from app.batch.results import Results, ResultsError, unfinished
from app.batch.shard import Shard, shards_of
from app.batch.worker import BatchWork, ShardDone, artifact_digest
from model import Registrar
from model.exceptions import InvalidOptionError

Engine = Literal["ray", "processes"]
# Told of the pairs to do, and then of each shard.
Progress = Callable[[int, ShardDone | None], None]

_TRUSTED = 0.9
_LARGEST_SHARD, _SHARDS_A_WORKER = 64, 4


@dataclass(frozen=True, slots=True)
class Batch:
    """What a caller asks for.

    Attributes:
        manifest: path or URL of the list of pairs.
        out: path or URL of the results' folder.
        artifact: directory or name; None for the shipped one.
        engine: ``ray`` or ``processes``; None takes Ray where it is installed.
        workers: of one core each.
        address: of a Ray cluster; None for this machine.
        shard: pairs in a file, and what a killed worker loses at most; None for up to 64, fewer
            where workers would have nothing to do.
        root: what relative paths are relative to; None for the manifest's folder.
        retry_errors: register anew what had an error.
    """

    manifest: str
    out: str
    artifact: str | None
    engine: Engine | None
    workers: int
    address: str | None = None
    shard: int | None = None
    root: str | None = None
    retry_errors: bool = False


def run_batch(batch: Batch, progress: Progress) -> dict[str, Any]:
    """Register what has no result yet.

    Returns:
        The summary, as it is also written to the results' folder.

    Raises:
        ManifestError: the manifest can't be used.
        StorageError: a place can't be reached.
        ResultsError: the folder holds other results.
        InvalidOptionError: an option out of its range.
        ArtifactError: the artifact can't be loaded.
        WorkersDieError: workers die without finishing anything.
    """
    _check(batch)
    manifest = read_manifest(batch.manifest, batch.root)
    digest = artifact_digest(Registrar.load(batch.artifact))
    results = Results.at(batch.out)
    if batch.retry_errors:
        results.forget_errors()
    left = unfinished(manifest.rows, digest, results.finished())
    results.tidy()
    work = BatchWork(_absolute(batch.artifact), digest, manifest.folder, results.place.address)
    started = perf_counter()
    progress(len(left), None)
    for done in _run(batch, shards_of(left, digest, _shard_size(batch, manifest)), work):
        progress(len(left), done)
    seconds = perf_counter() - started
    results.tidy()
    document = _summary(batch, manifest, results, len(left), seconds)
    results.write_summary(document)
    return document


def _run(batch: Batch, shards: Sequence[Shard], work: BatchWork) -> Iterator[ShardDone]:
    if not shards:
        return iter(())
    if engine_of(batch) == "ray":
        return run_on_ray(shards, work, batch.workers, batch.address)
    return run_in_processes(shards, work, batch.workers)


def engine_of(batch: Batch) -> Engine:
    """The engine that is asked for, or Ray where it is installed."""
    return batch.engine or ("ray" if ray_is_installed() else "processes")


def _check(batch: Batch) -> None:
    for field, value in (("workers", batch.workers), ("shard", batch.shard)):
        if value is not None and value < 1:
            raise InvalidOptionError(
                "not a positive number", field=field, value=value, mend="give 1 or more"
            )
    if batch.engine == "ray" and not ray_is_installed():
        raise InvalidOptionError(
            "Ray isn't installed",
            field="engine",
            value="ray",
            mend="pip install 'equivalign[ray]', or choose processes",
        )
    if batch.address is not None and engine_of(batch) != "ray":
        raise InvalidOptionError(
            "only Ray has clusters",
            field="address",
            value=batch.address,
            mend="pip install 'equivalign[ray]' and choose the engine ray, or leave it out",
        )


def _shard_size(batch: Batch, manifest: Manifest) -> int:
    """By the whole manifest, so that a re-run cuts it as before."""
    share = len(manifest.rows) // (batch.workers * _SHARDS_A_WORKER)
    return batch.shard or max(1, min(_LARGEST_SHARD, share))


def _absolute(artifact: str | None) -> str | None:
    """The same directory for workers in other folders; a name stays a name."""
    return os.path.abspath(artifact) if artifact and os.path.isdir(artifact) else artifact


def _summary(
    batch: Batch, manifest: Manifest, results: Results, registered: int, seconds: float
) -> dict[str, Any]:
    """Counts over all pairs of the manifest, and this run's own time."""
    rows = results.columns("pair_id", "error", "diagnostics")
    asked = {row.pair_id for row in manifest.rows}
    rows = rows.filter([pair in asked for pair in rows["pair_id"].to_pylist()])
    if len(rows) != len(asked):
        raise ResultsError(
            "pairs of the manifest are missing or doubled after the run",
            field="out",
            value=f"{len(rows)} rows for {len(asked)} pairs",
            mend="see that nobody else changes the folder, and run the same command again",
        )
    kinds = Counter(pc.drop_null(pc.struct_field(rows["error"], "type")).to_pylist())
    good = rows.filter(pc.is_null(rows["error"]))["diagnostics"]
    probability = pc.struct_field(good, "success_probability")
    trusted = pc.sum(pc.greater_equal(probability, _TRUSTED)).as_py()
    return {
        "pairs": len(manifest.rows),
        "succeeded": len(good),
        "errors": {kind.rpartition(":")[2]: count for kind, count in sorted(kinds.items())},
        "trusted": trusted or 0,
        "not_converged": pc.sum(pc.invert(pc.struct_field(good, "converged"))).as_py() or 0,
        "finished_before": len(manifest.rows) - registered,
        "registered_now": registered,
        "seconds": round(seconds, 3),
        "pairs_per_second": round(registered / seconds, 3) if registered else None,
        "workers": batch.workers,
        "engine": engine_of(batch),
        "results": results.place.address,
    }
