"""Time and memory from a thousand points to a million, each size in a process of its own."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Literal

import numpy as np
from rich.progress import Progress

from benchmarks.pair import BenchmarkPair
from benchmarks.pose_error import PoseError
from benchmarks.protocol import Column, Protocol, any_turn
from benchmarks.shape_pairs import ASYMMETRIC, ShapeChoice, ShapePairMaker, list_pairs
from benchmarks.shapes import PROCEDURAL, open_shapes
from benchmarks.sheet import Sheet
from model import Registrar
from training.data.perturbation import Perturbation

_STATUS = Path("/proc/self/status")
_WARM_UP_POINTS = 1000
_MIB = 2.0**20


@dataclass(frozen=True, slots=True)
class Measured:
    """One registration of a large pair.

    Attributes:
        seconds: wall time.
        peak: bytes above what the process held before; None where the system doesn't tell.
        T_target_source: the answer, (4, 4) as lists.
    """

    seconds: float
    peak: int | None
    T_target_source: list[list[float]]


def growth_sheet(sizes: list[int], artifact: str | None, seed: int, progress: Progress) -> Sheet:
    """Register one pair of each size.

    Args:
        sizes: points of each cloud.
        artifact: ours.
        seed: of the pairs.
        progress: shows how far it is.
    """
    rows = []
    task = progress.add_task("sizes", total=len(sizes))
    for size in sizes:
        pair = _pair(size, seed)
        measured = _measure_alone(pair, artifact)
        error = PoseError.of(np.array(measured.T_target_source), pair)
        rows.append(
            [
                f"{size:,}",
                f"{measured.seconds:.3f}",
                f"{1e6 * measured.seconds / size:.1f}",
                "–" if measured.peak is None else f"{measured.peak / _MIB:.0f}",
                f"{(pair.source.nbytes + pair.target.nbytes) / _MIB:.1f}",
                f"{error.rotation_deg:.2f}",
            ]
        )
        progress.advance(task)
    return Sheet(
        "growth with the number of points of each cloud",
        ["points", "s", "µs/point", "peak MiB", "input MiB", "rot. error °"],
        rows,
        note="Peak: the most resident memory that the process ever held (VmHWM) above what it held "
        f"(VmRSS) with both clouds loaded and a pair of {_WARM_UP_POINTS} points registered.",
    )


def _pair(size: int, seed: int) -> BenchmarkPair:
    """Resampled, σ = 0.01, any rotation; judged without a surface."""
    limits = (size, size)
    noisy = Perturbation(sigma=(0.01, 0.01), target_points=limits, source_points=limits)
    protocol = Protocol("hard", [Column("noisy", "σ", noisy)], [any_turn()])
    collection = open_shapes(PROCEDURAL, "test", seed, points=2 * size)
    choice = ShapeChoice(0, collection[0].name, 0.0, ASYMMETRIC)
    [entry] = list_pairs(protocol, [choice], seed)
    return ShapePairMaker(collection, protocol).make(entry)


def _measure_alone(pair: BenchmarkPair, artifact: str | None) -> Measured:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pair.npz"
        np.savez(path, source=pair.source, target=pair.target)
        # A fork would start with all memory that this process ever held.
        with get_context("spawn").Pool(1) as pool:
            return pool.apply(_measure, (path, artifact, pair.entry.seed))


def _measure(path: Path, artifact: str | None, seed: int) -> Measured:
    with np.load(path) as archive:
        source, target = archive["source"], archive["target"]
    registrar = Registrar.load(artifact)
    registrar.register(source[:_WARM_UP_POINTS], target[:_WARM_UP_POINTS], seed=seed)
    before = resident_bytes("VmRSS")
    start = time.perf_counter()
    result = registrar.register(source, target, seed=seed)
    seconds = time.perf_counter() - start
    after = resident_bytes("VmHWM")
    peak = None if before is None or after is None else after - before
    return Measured(seconds, peak, result.T_target_source.tolist())


def resident_bytes(entry: Literal["VmRSS", "VmHWM"]) -> int | None:
    """Memory that this process holds, or the most it ever held; None where Linux doesn't tell."""
    if not _STATUS.is_file():
        return None
    for line in _STATUS.read_text().splitlines():
        if line.startswith(f"{entry}:"):
            return 1024 * int(line.split()[1])
    return None
