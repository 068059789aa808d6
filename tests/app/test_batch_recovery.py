"""Workers and drivers that are killed: no pair is lost, doubled or changed."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow isn't installed")
from batch_run import (
    command,
    kill_worker,
    poses,
    registered_alone,
    results,
    running,
    wait_for_shards,
    write_pairs,
)

from app.batch.manifest import read_manifest
from app.batch.on_ray import ray_is_installed
from app.batch.results import Results
from app.batch.shard import shards_of
from app.batch.worker import BatchWork, ShardWorker

PAIRS, SHARD = 36, 3
# Of Ray, only a worker is killed otherwise: its second start takes a quarter of a minute.
ALL_ON_RAY = os.environ.get("EQUIVALIGN_RAY_TESTS") == "all"

needs_ray = pytest.mark.skipif(not ray_is_installed(), reason="Ray isn't installed")


@pytest.mark.parametrize("engine", ["processes", pytest.param("ray", marks=needs_ray)])
def test_killed_workers_and_drivers_lose_and_double_nothing(
    engine: str, artifact: Path, tmp_path: Path
) -> None:
    manifest, out = write_pairs(tmp_path / "clouds", PAIRS), tmp_path / "results"
    words = command(
        manifest, out, artifact, "--engine", engine, "--workers", "2", "--shard", str(SHARD)
    )
    finished: dict[str, bytes] = {}
    with running(words) as process:
        (first, *_) = wait_for_shards(out, 1, process)
        killed = kill_worker(first)
        if engine == "processes" or ALL_ON_RAY:
            finished = {path.name: path.read_bytes() for path in wait_for_shards(out, 5, process)}
            process.send_signal(signal.SIGKILL)
            process.wait(30)
        else:
            said, complaints = process.communicate(timeout=120)
    if finished:
        with running(words) as process:
            said, complaints = process.communicate(timeout=120)
    assert process.returncode == 0, complaints
    summary = json.loads(said)
    assert summary["pairs"] == summary["succeeded"] == PAIRS
    assert summary["finished_before"] >= len(finished) * SHARD
    assert summary["finished_before"] + summary["registered_now"] == PAIRS
    assert summary["engine"] == engine

    assert {name: (out / name).read_bytes() for name in finished} == finished
    table = results(out)
    assert table.num_rows == PAIRS
    workers = set(table["worker"].to_pylist())
    # The other worker may have done the rest alone before a new one was there.
    assert len(workers) >= (3 if finished else 2)
    assert any(name.endswith(f":{killed}") for name in workers)
    found, alone = poses(table), registered_alone(manifest, artifact)
    assert found.keys() == alone.keys()
    for pair, T in alone.items():
        np.testing.assert_array_equal(found[pair], T)
    left = [name for name in os.listdir(out) if not name.startswith("part-")]
    assert sorted(left) == ["_attempts", "_summary.json"]
    assert os.listdir(out / "_attempts") == []


def test_a_pair_that_kills_its_process_becomes_an_error(
    artifact: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading one of the clouds ends the process, as the kernel does when memory is short."""
    manifest = read_manifest(str(write_pairs(tmp_path / "clouds", 3)))
    (tmp_path / "clouds" / "source-1.npy").rename(tmp_path / "clouds" / "deadly.npy")
    (tmp_path / "clouds" / "source-1.npy").symlink_to("deadly.npy")
    (tmp_path / "sitecustomize.py").write_text(
        "import os, pathlib, signal\n"
        "read = pathlib.Path.read_bytes\n"
        "def read_bytes(path):\n"
        "    if path.resolve().name == 'deadly.npy':\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return read(path)\n"
        "pathlib.Path.read_bytes = read_bytes\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(Path.cwd())]))
    (shard,) = shards_of(manifest.rows, "digest", 64)
    results = Results.at(str(tmp_path / "out"))
    for earlier in range(2):
        assert results.begin(shard) == earlier
    worker = ShardWorker(BatchWork(str(artifact), "digest", manifest.folder, results.place.address))
    done = worker(shard)
    assert (done.pairs, done.errors) == (3, 1)
    rows = results.columns("pair_id", "error", "T_target_source").to_pylist()
    assert [row["error"] is None for row in rows] == [True, False, True]
    assert rows[1]["error"]["type"] == "urn:equivalign:problem:worker-died"
    assert rows[1]["T_target_source"] is None
    assert results.begin(shard) == 0
