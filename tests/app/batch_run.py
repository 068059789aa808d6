"""Batches in another process, to be killed, and what must be in their results."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch

from model import Registrar
from model.se3 import axis_angle_rotation

Command = subprocess.Popen[str]


def write_pairs(folder: Path, pairs: int, points: int = 96) -> Path:
    """A manifest of pairs that turn about different axes, and their clouds."""
    folder.mkdir(exist_ok=True)
    lines = []
    for number in range(pairs):
        rng = np.random.default_rng(number)
        source = rng.normal(size=(points, 3)) * [1.0, 0.6, 0.3]
        axis = torch.from_numpy(rng.normal(size=3))
        R = axis_angle_rotation(axis, torch.tensor(0.5 + number % 5, dtype=torch.float64)).numpy()
        np.save(folder / f"source-{number}.npy", source)
        np.save(folder / f"target-{number}.npy", source @ R.T + rng.normal(size=3))
        row = {"source": f"source-{number}.npy", "target": f"target-{number}.npy"}
        lines.append(json.dumps(row | {"pair_id": f"pair-{number}", "seed": number}))
    manifest = folder / "pairs.jsonl"
    manifest.write_text("\n".join(lines))
    return manifest


def registered_alone(manifest: Path, artifact: Path) -> dict[str, np.ndarray]:
    """What the registrar itself answers, one pair after another in this process."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    registrar = Registrar.load(artifact)
    poses = {}
    try:
        for row in map(json.loads, manifest.read_text().splitlines()):
            source, target = (np.load(manifest.parent / row[name]) for name in ("source", "target"))
            found = registrar.register(source, target, seed=row["seed"])
            poses[row["pair_id"]] = found.T_target_source
    finally:
        torch.set_num_threads(threads)
    return poses


def command(manifest: Path, out: Path, artifact: Path, *more: str) -> list[str]:
    start = "import sys; from app.command_line import main; sys.exit(main())"
    given = ["batch", str(manifest), "--out", str(out), "--artifact", str(artifact), "--json"]
    return [sys.executable, "-c", start, *given, *more]


@contextmanager
def running(words: list[str]) -> Iterator[Command]:
    """A batch in another process; killed at the end of the block, if it still runs."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for_shards(out: Path, count: int, process: Command) -> list[Path]:
    end = time.monotonic() + 120
    while len(found := sorted(out.glob("part-*.parquet"))) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


def kill_worker(shard: Path) -> int:
    """``kill -9`` the worker that wrote a shard."""
    worker = int(pq.read_table(shard)["worker"][0].as_py().rpartition(":")[2])
    os.kill(worker, signal.SIGKILL)
    return worker


def results(out: Path) -> pa.Table:
    return pa.concat_tables(pq.read_table(path) for path in sorted(out.glob("part-*.parquet")))


def poses(table: pa.Table) -> dict[str, np.ndarray]:
    rows = zip(table["pair_id"].to_pylist(), table["T_target_source"].to_pylist(), strict=True)
    return {pair: np.array(T) for pair, T in rows}
