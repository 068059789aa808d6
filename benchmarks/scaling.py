"""``scaling``: a batch on one process, on one worker and on several; what grows and what doesn't.

Each part is a run of its own, so that the machine can be left alone meanwhile: first
``--part alone``, then ``--part workers --workers 1``, then ``2``, ``--part driver``, and
``--part report``.
"""

from __future__ import annotations

import json
import os
import shutil
from argparse import ArgumentParser
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch

from benchmarks.batch_pairs import write_batch
from benchmarks.batch_process import result_bytes, results, run_batch, shard_seconds
from benchmarks.folder import make_folder
from benchmarks.provenance import Provenance
from benchmarks.results import FORMAT_VERSION, read_json, write_json
from benchmarks.scaling_report import Measurements, scaling_sheets
from benchmarks.speed_file import SpeedResults
from benchmarks.table import print_sheets, wide_console
from model import Registrar
from model.exceptions import InvalidOptionError

_ALONE, _DRIVER = "alone", "driver"
# Shards of pairs that cost nothing.
_FEW, _MANY, _SIZE = 50, 1000, 64


def scaling_command(arguments: list[str], command: str) -> int:
    """Measure one part, or report on those that were measured.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = _parser().parse_args(arguments)
    folder = make_folder(given.folder, "folder")
    run = Provenance.now(command)
    manifest = write_batch(folder / "pairs", given.pairs, given.points, given.seed)
    if given.part == "alone":
        _keep(folder, _ALONE, run, _register_alone(manifest, folder))
    elif given.part == "workers":
        _keep(folder, f"{given.engine}-{given.workers}", run, _on_workers(given, manifest))
    elif given.part == "driver":
        _keep(folder, _DRIVER, run, _driver(given))
    elif given.part == "report":
        return _report(given)
    return 0


def _register_alone(manifest: Path, folder: Path) -> dict[str, Any]:
    """One pair after another in this process, on one core, by the registrar itself."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    torch.set_num_threads(1)
    registrar = Registrar.load()
    rows = [json.loads(line) for line in manifest.read_text().splitlines()]
    poses = np.empty((len(rows), 4, 4))
    # Compiled loops are loaded, or compiled, at the first call.
    _register(registrar, manifest, rows[0])
    started = perf_counter()
    for number, row in enumerate(rows):
        poses[number] = _register(registrar, manifest, row)
    seconds = perf_counter() - started
    np.save(folder / f"{_ALONE}.npy", poses)
    return {"pairs": len(rows), "work_seconds": seconds}


def _register(registrar: Registrar, manifest: Path, row: dict[str, Any]) -> Any:
    source, target = (np.load(manifest.parent / row[role]) for role in ("source", "target"))
    return registrar.register(source, target, seed=row["seed"]).T_target_source


def _on_workers(given: Any, manifest: Path) -> dict[str, Any]:
    out = given.folder / f"results-{given.engine}-{given.workers}"
    shutil.rmtree(out, ignore_errors=True)
    run = run_batch(manifest, out, given.engine, given.workers)
    table = results(out)
    alone = np.load(given.folder / f"{_ALONE}.npy")
    found = np.array(table["T_target_source"].to_pylist())
    stages: dict[str, list[float]] = {}
    for diagnostics in table["diagnostics"].to_pylist():
        for stage, seconds in diagnostics["seconds"]:
            stages.setdefault(stage, []).append(seconds)
    return asdict(run) | {
        "rows": table.num_rows,
        "pair_ids": len(set(table["pair_id"].to_pylist())),
        "errors": table.num_rows - table["error"].null_count,
        "equal_to_alone": int((found == alone).all(axis=(1, 2)).sum()),
        "row_seconds": float(np.mean(table["seconds"])),
        "reading_seconds": float(np.mean(table["seconds_reading"])),
        "stage_seconds": {stage: float(np.mean(seconds)) for stage, seconds in stages.items()},
        "result_bytes": result_bytes(out) / table.num_rows,
        "input_bytes": _input_bytes(manifest) / table.num_rows,
    }


def _driver(given: Any) -> dict[str, Any]:
    """What a shard costs beside its pairs: those here fail at once, for want of their clouds."""
    seconds = {}
    for shards in (_FEW, _MANY):
        folder = given.folder / f"empty-{shards}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        row = json.dumps({"source": "nowhere.npy", "target": "nowhere.npy"})
        manifest = folder / "pairs.jsonl"
        manifest.write_text(f"{row}\n" * (shards * _SIZE))
        run = run_batch(manifest, folder / "out", given.engine, given.workers, _SIZE)
        seconds[shards] = run.work_seconds
    spent = (seconds[_MANY] - seconds[_FEW]) / (_MANY - _FEW)
    return {"engine": given.engine, "workers": given.workers, "seconds_a_shard": spent}


def _input_bytes(manifest: Path) -> int:
    return sum(path.stat().st_size for path in manifest.parent.glob("*.npy"))


def _keep(folder: Path, name: str, run: Provenance, measured: dict[str, Any]) -> None:
    content = {
        "format_version": FORMAT_VERSION,
        "measured": measured,
        "run": asdict(run),
    }
    write_json(folder / f"{name}.json", content)


def _report(given: Any) -> int:
    parts = {path.stem: read_json(path) for path in sorted(given.folder.glob("*.json"))}
    if not {_ALONE, _DRIVER} < parts.keys():
        raise InvalidOptionError(
            "nothing to compare yet",
            field="part",
            value="report",
            mend="measure --part alone, --part workers at least once, and --part driver",
        )
    alone, driver = parts.pop(_ALONE), parts.pop(_DRIVER)
    measured = Measurements(
        alone["measured"],
        [part["measured"] | _seconds(given.folder, name) for name, part in parts.items()],
        driver["measured"]["seconds_a_shard"],
        given.points,
    )
    sheets = scaling_sheets(measured, given.extrapolate)
    print_sheets(sheets, wide_console())
    if given.out is not None:
        runs = [Provenance(**part["run"]) for part in (alone, *parts.values(), driver)]
        settings = {"pairs": given.pairs, "points": given.points, "seed": given.seed}
        SpeedResults(settings, runs, {}, sheets, "scaling").write(given.out)
    return 0


def _seconds(folder: Path, name: str) -> dict[str, list[float]]:
    """Of every shard and every pair of a run."""
    shards = list(shard_seconds(folder / f"results-{name}").values())
    return {"shard_seconds": list(map(sum, shards)), "pair_seconds": [s for p in shards for s in p]}


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign benchmark scaling", description=__doc__)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of pairs and measurements")
    parser.add_argument(
        "--part", choices=["pairs", "alone", "workers", "driver", "report"], default="report"
    )
    parser.add_argument("--engine", choices=["ray", "processes"], default="ray")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="default 1")
    parser.add_argument("--pairs", type=int, default=2000, metavar="N", help="default 2000")
    parser.add_argument("--points", type=int, default=512, metavar="N", help="default 512")
    parser.add_argument(
        "--extrapolate", type=int, default=1_000_000, metavar="N", help="pairs; default a million"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, metavar="FILE", help="the report as JSON")
    return parser
