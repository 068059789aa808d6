"""Time a pair: any rotation, and with a guess, against RANSAC on the same pairs in turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from rich.progress import Progress

from benchmarks.figures import percent
from benchmarks.methods import Answer, Method
from benchmarks.methods.equivalign import EquivAlign
from benchmarks.pair import BenchmarkPair, FloatArray
from benchmarks.pose_error import ADDS_SUCCESS, PoseError
from benchmarks.protocol import Column, Protocol, any_turn
from benchmarks.shape_pairs import ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import PROCEDURAL, open_shapes
from benchmarks.sheet import Sheet
from model.se3 import retract
from training.data.perturbation import Perturbation
from training.data.seeding import Stream, torch_generator

POINTS = 1024
GUESS_WITHIN_DEG = 15.0
_GUESS_SHIFT = 0.05
_LAP_HEAD = ["median s", "90th percentile s", "median CPU s", f"ADD-S < {ADDS_SUCCESS}"]

_NOISY = Perturbation(
    sigma=(0.01, 0.01),
    outlier_share=(0.2, 0.2),
    target_points=(POINTS, POINTS),
    source_points=(POINTS, POINTS),
)


@dataclass(frozen=True, slots=True)
class RacePairs:
    """Resampled pairs with noise and outliers, 1024 points each, over all of SO(3).

    Attributes:
        count: how many, each of a shape of its own.
        seed: non-negative.
    """

    count: int
    seed: int

    def __iter__(self) -> Iterator[BenchmarkPair]:
        """One after another."""
        protocol = Protocol("hard", [Column("noisy", "σ + outliers", _NOISY)], [any_turn()])
        collection = open_shapes(PROCEDURAL, "test", self.seed)
        maker = ShapePairMaker(collection, protocol)
        for entry in list_pairs(protocol, choose_shapes(collection, self.count, 0), self.seed):
            yield maker.make(entry)


@dataclass(frozen=True, slots=True)
class Lap:
    """One registration.

    Attributes:
        seconds: wall time.
        cpu_seconds: of all threads; a busy machine leaves it as it is.
        success: whether ADD-S is below 0.03.
    """

    seconds: float
    cpu_seconds: float
    success: bool


@dataclass(frozen=True, slots=True)
class GlobalRace:
    """Laps over the same pairs; the kinds take turns.

    Attributes:
        ours: from no guess.
        ransac: FPFH + RANSAC + ICP.
        local: ours, with a guess within 15° and told to stay within them, searching locally.
        prepared: the same on a target that was prepared before.
        stages: seconds of each of our stages, a list entry a pair.
    """

    ours: list[Lap]
    ransac: list[Lap]
    local: list[Lap]
    prepared: list[Lap]
    stages: list[dict[str, float]]

    @classmethod
    def run(
        cls, ours: EquivAlign, ransac: Method, pairs: RacePairs, progress: Progress
    ) -> GlobalRace:
        """Race, after one pair off the record."""
        race = cls([], [], [], [], [])
        task = progress.add_task("pairs", total=pairs.count)
        for number, pair in enumerate(pairs):
            if number == 0:
                cls([], [], [], [], [])._lap(ours, ransac, pair, number)
            race._lap(ours, ransac, pair, number)
            progress.advance(task)
        return race

    def _lap(self, ours: EquivAlign, ransac: Method, pair: BenchmarkPair, number: int) -> None:
        turns: list[Callable[[], None]] = [
            lambda: self._globally(ours, pair),
            lambda: self.ransac.append(_lap(ransac, pair)[0]),
            lambda: self.local.append(_local_lap(ours, pair, prepared=False)),
            lambda: self.prepared.append(_local_lap(ours, pair, prepared=True)),
        ]
        first = number % len(turns)
        for turn in (*turns[first:], *turns[:first]):
            turn()

    def _globally(self, ours: EquivAlign, pair: BenchmarkPair) -> None:
        lap, answer = _lap(ours, pair)
        self.ours.append(lap)
        self.stages.append(answer.findings["stages"])

    def global_sheet(self) -> Sheet:
        """Ours against RANSAC: medians, their ratio, and that neither is fast by being wrong."""
        ours, ransac = _seconds(self.ours), _seconds(self.ransac)
        ratios = [
            f"{np.median(ours) / np.median(ransac):.2f}",
            f"{np.median(ours / ransac):.2f}",
        ]
        return Sheet(
            f"{POINTS} resampled points, σ and outliers, any rotation, {len(ours)} pairs",
            ["method", *_LAP_HEAD, "ratio of medians", "median of ratios"],
            [
                ["ours", *_figures(self.ours), *ratios],
                ["ransac", *_figures(self.ransac), "1.00", "1.00"],
            ],
            note="Encoding included; methods take turns on each pair. Ratios are of wall times; "
            "below 1: faster than RANSAC.",
        )

    def stage_sheet(self) -> Sheet:
        """Where our time goes."""
        names = list(dict.fromkeys(name for stages in self.stages for name in stages))
        medians = {n: float(np.median([s.get(n, 0.0) for s in self.stages])) for n in names}
        total = medians.get("total", sum(medians.values()))
        return Sheet(
            "ours, by stage",
            ["stage", "median s", "share"],
            [[n, f"{s:.4f}", f"{100.0 * s / total:.0f} %"] for n, s in medians.items()],
        )

    def local_sheet(self) -> Sheet:
        """With a guess."""
        within = f"{GUESS_WITHIN_DEG:g}°"
        local, prepared = _seconds(self.local), _seconds(self.prepared)
        gain = f"{np.median(local) / np.median(prepared):.2f}"
        return Sheet(
            f"the same pairs, a guess within {within}, local search within {within} of it",
            ["method", *_LAP_HEAD, "times faster"],
            [
                ["ours", *_figures(self.local), "1.00"],
                ["ours, target prepared", *_figures(self.prepared), gain],
            ],
        )


def _lap(method: Method, pair: BenchmarkPair) -> tuple[Lap, Answer]:
    wall, cpu = time.perf_counter(), time.process_time()
    answer = method.register(pair.source, pair.target, pair.entry.seed)
    seconds, cpu_seconds = time.perf_counter() - wall, time.process_time() - cpu
    return Lap(seconds, cpu_seconds, _succeeds(answer.T_target_source, pair)), answer


def _local_lap(ours: EquivAlign, pair: BenchmarkPair, prepared: bool) -> Lap:
    guess = _guess(pair)
    target = ours.registrar.prepare(pair.target) if prepared else pair.target
    wall, cpu = time.perf_counter(), time.process_time()
    result = ours.registrar.register(
        pair.source,
        target,
        initial=guess,
        max_rotation_deg=GUESS_WITHIN_DEG,
        search="local",
        seed=pair.entry.seed,
    )
    seconds, cpu_seconds = time.perf_counter() - wall, time.process_time() - cpu
    return Lap(seconds, cpu_seconds, _succeeds(result.T_target_source, pair))


def _guess(pair: BenchmarkPair) -> FloatArray:
    """The true pose, moved by an angle uniform below 15° about the target's centre, and shifted."""
    generator = torch_generator(pair.entry.seed, Stream.MOTION, 1)
    direction = torch.nn.functional.normalize(torch.randn(2, 3, generator=generator), dim=1)
    size = torch.rand(2, generator=generator) * torch.tensor(
        [_GUESS_SHIFT, np.radians(GUESS_WITHIN_DEG)]
    )
    delta = (size[:, None] * direction).reshape(1, 6).double()
    return retract(torch.from_numpy(pair.T_target_source)[None], delta)[0].numpy()


def _succeeds(T: FloatArray, pair: BenchmarkPair) -> bool:
    adds = PoseError.of(T, pair).adds
    return adds is not None and adds < ADDS_SUCCESS


def _seconds(laps: list[Lap]) -> FloatArray:
    return np.array([lap.seconds for lap in laps])


def _figures(laps: list[Lap]) -> list[str]:
    wall = _seconds(laps)
    return [
        f"{np.median(wall):.4f}",
        f"{np.quantile(wall, 0.9):.4f}",
        f"{np.median([lap.cpu_seconds for lap in laps]):.4f}",
        percent(float(np.mean([lap.success for lap in laps]))),
    ]
