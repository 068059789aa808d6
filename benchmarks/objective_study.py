"""One training by one objective on few points, and what its encoder is worth afterwards."""

from __future__ import annotations

import logging
import math
import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from lightning import Trainer
from torch import Tensor

from benchmarks.objective import Objective
from model.cloud_function import CloudFunction
from model.inner_loop import ProcrustesLoop
from model.se3 import rotation_angle
from training.bilevel import BilevelSolver
from training.curriculum import Stage
from training.data.motion import Motion
from training.data.packed import PackedShapes, read_packed
from training.data.pairs import PairBatch, PairKey, ShapePairs, collate
from training.data.perturbation import Perturbation
from training.data.seeding import Stream, torch_generator
from training.data.shape_module import ShapeDataModule, Subset
from training.data.splits import subset_rows
from training.frame import in_joint_frame
from training.metrics import RECALL_DEG, effective_rank
from training.module import EquivAlign

ANGLE = 45.0
CURRICULA = {"curriculum": (5.0, 10.0, 20.0, 30.0, ANGLE), "direct": (ANGLE,)}
# Annealed as for registration; and with ℓ as large as in the paper, where points alone say little.
SOLVERS = {"fine": (0.3, 0.08), "coarse": (1.0, 0.3)}
MEASURED = (("clean", "fine"), ("resampled", "fine"), ("resampled", "coarse"))
_BATCH = 24


@dataclass(frozen=True)
class StudySettings:
    """What decides the figures, apart from objective, curriculum and seed.

    Attributes:
        shapes: archive of shapes, as ``equivalign data pack`` writes them.
        points: of each cloud.
        steps: outer steps of a training.
        batch_size: pairs a step.
        test_pairs: of each kind.
        symmetric_above: shapes with a greater self-similarity are left out.
        learning_rate: of AdamW.
        kernel: name of the feature kernel.
    """

    shapes: str
    points: int = 128
    steps: int = 200
    batch_size: int = 8
    test_pairs: int = 160
    symmetric_above: float = 0.98
    learning_rate: float = 8e-3
    kernel: str = "exponential"


ARCHITECTURE = {
    "channels": 16,
    "channels_out": 8,
    "invariants": 32,
    "radii": [0.1, 0.2, 0.4],
    "layers": 2,
}


class _TrainingPairs(ShapeDataModule):
    """Pairs of given shapes."""

    def __init__(self, given: PackedShapes, **options: Any) -> None:
        super().__init__(**options)
        self.given = given

    def shapes(self, subset: Subset) -> PackedShapes:
        return self.given


class Study:
    """The shapes and the test pairs that all trainings share.

    Args:
        settings: of the study.

    Raises:
        EquivAlignError: the archive can't be used.
    """

    def __init__(self, settings: StudySettings) -> None:
        self.settings = settings
        shapes = read_packed(Path(settings.shapes)).without_symmetric(settings.symmetric_above)
        parts = {
            subset: shapes.select(subset_rows(shapes.splits, subset, "random", seed=0))
            for subset in ("train", "test")
        }
        self.training_shapes = parts["train"]
        self.pairs = {
            "clean": self._test_pairs(parts["test"], resample=0.0),
            "resampled": self._test_pairs(parts["test"], resample=1.0),
        }

    def _test_pairs(self, shapes: PackedShapes, resample: float) -> list[PairBatch]:
        n, count = self.settings.points, self.settings.test_pairs
        pairs = ShapePairs(shapes, _clouds(n, resample), count, 0, Stream.TEST)
        motion = Motion("exact_angle", ANGLE)
        moved = [
            pairs[PairKey(0, i)].moved(motion.draw(torch_generator(0, Stream.MOTION, i)))
            for i in range(count)
        ]
        return [in_joint_frame(collate(moved[i : i + _BATCH])) for i in range(0, count, _BATCH)]

    def run(self, objective: Objective, curriculum: str, seed: int) -> dict[str, Any]:
        """Train one encoder and measure it.

        Args:
            objective: what it is trained by.
            curriculum: name in ``CURRICULA``.
            seed: of the weights, the training pairs and the losses.

        Returns:
            recall at 5° and median error in degrees by kind of pair and solver, the features'
            effective rank, and the seconds of the training.
        """
        torch.manual_seed(seed)
        model = self._model(objective, CURRICULA[curriculum], seed)
        started = time.perf_counter()
        if objective.encoder == "trained":
            self._train(model, objective, seed)
        seconds = time.perf_counter() - started
        return {
            "measured": self._measure(model.eval(), objective.encoder != "none"),
            "seconds": round(seconds, 1),
        }

    def _model(self, objective: Objective, angles: tuple[float, ...], seed: int) -> EquivAlign:
        rate = objective.learning_rate or self.settings.learning_rate
        high, low = SOLVERS["fine"]
        stages = [
            Stage(
                max_angle=angle,
                max_steps=math.ceil(self.settings.steps / len(angles)),
                # By steps alone, so that all objectives see the same angles.
                success=1.1,
                lengthscale=high,
                lengthscale_bounds=(low, 2.0),
                learning_rate=rate,
            )
            for angle in angles
        ]
        return EquivAlign(
            architecture=ARCHITECTURE,
            kernel=objective.kernel or self.settings.kernel,
            loss=dict(objective.loss) or None,
            loss_settings={name: dict(given) for name, given in objective.settings.items()},
            bilevel=BilevelSolver(
                backward=objective.backward, iterations=5, anneal=0.5, steps_per_level=3
            ),
            curriculum=stages,
            cosine=True,
            gate_confidence=objective.gated,
            seed=seed,
        )

    def _train(self, model: EquivAlign, objective: Objective, seed: int) -> None:
        settings = self.settings
        detached = objective.backward == "detached_step"
        batches = settings.steps // (model.inner_steps if detached else 1)
        data = _TrainingPairs(
            self.training_shapes,
            seed=seed,
            batch_size=settings.batch_size,
            pairs_per_epoch=batches * settings.batch_size,
            perturbation=_clouds(settings.points, 1.0, sigma=0.01),
            motion=Motion("uniform_angle", ANGLE),
        )
        with warnings.catch_warnings():
            # Lightning's advice on workers and loggers that nothing here needs.
            warnings.simplefilter("ignore")
            logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
            Trainer(
                accelerator="cpu",
                max_steps=settings.steps,
                max_epochs=1,
                limit_val_batches=0,
                gradient_clip_val=None if detached else 1.0,
                deterministic=True,
                logger=False,
                enable_checkpointing=False,
                enable_progress_bar=False,
                enable_model_summary=False,
            ).fit(model, datamodule=data)

    @torch.no_grad()
    def _measure(self, model: EquivAlign, features: bool) -> dict[str, dict[str, float]]:
        found: dict[str, dict[str, float]] = {}
        for kind, solver in MEASURED:
            batches = self.pairs[kind]
            clouds = [self._encoded(model, batch, features) for batch in batches]
            errors = torch.cat(
                [
                    _rotation_errors(model, solver, *pair, batch)
                    for pair, batch in zip(clouds, batches, strict=True)
                ]
            )
            found[f"{kind}, {solver}"] = {
                "recall": float((errors < RECALL_DEG).float().mean()),
                "median_deg": float(errors.median()),
            }
        if features:
            rank = torch.cat([effective_rank(target) for target, _ in clouds]).mean()
            found["features"] = {"effective_rank": float(rank)}
        return found

    def _encoded(
        self, model: EquivAlign, batch: PairBatch, features: bool
    ) -> tuple[CloudFunction, CloudFunction]:
        target, source = model.encode(batch)
        if features:
            return target, source
        return target.without_features(), source.without_features()


def _clouds(points: int, resample: float, sigma: float = 0.0) -> Perturbation:
    return Perturbation(
        sigma=(0.0, sigma),
        target_points=(points, points),
        source_points=(points, points),
        resample_probability=resample,
    )


def _rotation_errors(
    model: EquivAlign, solver: str, target: CloudFunction, source: CloudFunction, batch: PairBatch
) -> Tensor:
    """In degrees, (B,); from no motion, which is wrong by the whole angle. NaN counts as 180."""
    high, low = SOLVERS[solver]
    loop = ProcrustesLoop(
        lengthscale=high, lengthscale_end=low, anneal=0.6, final_steps=15, record=False
    )
    start = torch.eye(4).repeat(len(batch.target), 1, 1)
    R = loop.solve(model.kernel, target, source, start).T_target_source[:, :3, :3]
    error = rotation_angle(R, batch.T_target_source[:, :3, :3]) * (180.0 / math.pi)
    return error.nan_to_num(180.0)


def plain(settings: StudySettings) -> dict[str, Any]:
    """The settings as they stand in a results file; of the archive only its name."""
    return {**asdict(settings), "shapes": Path(settings.shapes).name, **_FIXED}


_FIXED: dict[str, Any] = {
    "angle": ANGLE,
    "curricula": {name: list(angles) for name, angles in CURRICULA.items()},
    "solvers": {name: list(ells) for name, ells in SOLVERS.items()},
    "architecture": ARCHITECTURE,
}
