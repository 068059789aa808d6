"""``equivalign batch`` as a process of its own, with each worker on a core of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import pyarrow as pa
import pyarrow.dataset as pads
import pyarrow.parquet as pq

from model.exceptions import EquivAlignError

_MIB = 2**20
# How a worker's process is called: by Ray, and by Python's own pool.
_WORKERS = ("ray::MapWorker", "spawn_main")
_LOOK_SECONDS = 1.0
# Adding up memory takes time from the workers.
_LOOKS_A_MEASUREMENT = 15


@dataclass(frozen=True, slots=True)
class BatchRun:
    """What one run of a batch took.

    Attributes:
        engine: ``ray`` or ``processes``.
        workers: each pinned to one core.
        pairs: registered.
        whole_seconds: from the command's start to its end.
        start_seconds: until the first worker began its first shard.
        work_seconds: from then to the end of the last shard.
        worker_mib: memory of one worker that it shares with nobody, the most seen.
        around_mib: the same of all other processes together: driver, and Ray's own.
    """

    engine: str
    workers: int
    pairs: int
    whole_seconds: float
    start_seconds: float
    work_seconds: float
    worker_mib: float
    around_mib: float


def run_batch(manifest: Path, out: Path, engine: str, workers: int, shard: int = 32) -> BatchRun:
    """Run the batch once into a new folder.

    Args:
        manifest: list of pairs.
        out: the results' folder, not there yet.
        engine: ``ray`` or ``processes``.
        workers: at most as many as there are cores.
        shard: pairs in a shard.

    Raises:
        EquivAlignError: the batch failed.
    """
    command = [str(Path(sys.executable).with_name("equivalign")), "batch", str(manifest)]
    command += ["--out", str(out), "--engine", engine, "--workers", str(workers), "--json"]
    command += ["--shard", str(shard)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    began = time.time()
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    watch = _Watch(process.pid)
    looks = 0
    while process.poll() is None:
        looks += 1
        watch.look(memory=looks % _LOOKS_A_MEASUREMENT == 0)
        time.sleep(_LOOK_SECONDS)
    said, complaint = process.communicate()
    whole = time.time() - began
    if process.returncode:
        raise EquivAlignError("the batch failed", value=complaint[-500:])
    first, last = _first_and_last(out)
    return BatchRun(
        engine,
        workers,
        json.loads(said)["registered_now"],
        whole,
        first - began,
        last - first,
        watch.worker_bytes / _MIB,
        watch.around_bytes / _MIB,
    )


def results(out: Path) -> pa.Table:
    """All rows, by pair."""
    return pads.dataset(out, format="parquet").to_table().sort_by("pair_id")


def result_bytes(out: Path) -> int:
    """Of all shards."""
    return sum(path.stat().st_size for path in out.glob("*.parquet"))


def shard_seconds(out: Path) -> dict[Path, list[float]]:
    """Seconds of each pair, by shard, in the manifest's order."""
    return {
        path: pq.read_table(path, columns=["seconds"])["seconds"].to_pylist()
        for path in sorted(out.glob("*.parquet"))
    }


def _first_and_last(out: Path) -> tuple[float, float]:
    """When the first shard was begun and the last one written."""
    ends = {path: path.stat().st_mtime for path in out.glob("*.parquet")}
    begun = [ends[path] - sum(seconds) for path, seconds in shard_seconds(out).items()]
    return min(begun), max(ends.values())


class _Watch:
    """Pins workers to cores as they appear, and remembers the most memory that it saw.

    Args:
        driver: its process id.
    """

    def __init__(self, driver: int) -> None:
        self._driver = psutil.Process(driver)
        self._cores: dict[int, int] = {}
        self.worker_bytes = 0
        self.around_bytes = 0

    def look(self, memory: bool) -> None:
        """Pin what is new; and, where asked, add up the memory."""
        around = 0
        try:
            below = [self._driver, *self._driver.children(recursive=True)]
        except psutil.NoSuchProcess:
            return
        for process in below:
            try:
                works = any(name in " ".join(process.cmdline()) for name in _WORKERS)
                if works:
                    self._pin(process)
                if memory:
                    own = process.memory_full_info().uss
                    self.worker_bytes = max(self.worker_bytes, own if works else 0)
                    around += 0 if works else own
            except psutil.Error:
                continue
        self.around_bytes = max(self.around_bytes, around)

    def _pin(self, process: psutil.Process) -> None:
        if process.pid not in self._cores:
            usable = sorted(os.sched_getaffinity(0))
            self._cores[process.pid] = usable[len(self._cores) % len(usable)]
            process.cpu_affinity([self._cores[process.pid]])
