"""Adaptation without labels: judged on held-back frames, and kept only where it is better."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from lightning import Callback, LightningModule, Trainer
from rich.console import Console

from model import Registrar
from model.artifact import Artifact, load_artifact, save_artifact
from model.cloud_file import complete_file
from model.exceptions import InvalidOptionError
from model.odometry import Cycle
from model.odometry.frame import FramePreparer, Framing
from model.sequence import FrameSource
from training.data.motion import Motion
from training.data.seeding import Stream, torch_generator
from training.data.tracked_module import TrackedData

FloatArray = npt.NDArray[np.float64]

ADAPTED, VERDICT = "adapted", "verdict.json"
# A loop that ends within this of where it began is closed; the length is a share of the radius.
_CLOSED_DEG, _CLOSED_SHARE = 5.0, 0.05
_ANY_TURN = Motion("haar", 180.0)


@dataclass(frozen=True, slots=True)
class LabelFreeScore:
    """How a registrar does on triples of frames, as far as it can tell by itself.

    Attributes:
        triples: that were gone around.
        closed: share of those that end where they began.
        similarity: mean ρ of the three registrations of all triples; on the surface kernel, which
            no feature enters, so that two encoders compare.
        cycle_rotation_deg: mean over the triples.
        cycle_translation: mean over the triples, in the input's unit.
    """

    triples: int
    closed: float
    similarity: float
    cycle_rotation_deg: float
    cycle_translation: float

    def is_better_than(self, other: LabelFreeScore) -> bool:
        """Closes more loops and agrees no worse, or closes as many and agrees better.

        Both have to speak for it: poses that are wrong together close loops, too.
        """
        if self.closed != other.closed:
            return self.closed > other.closed and self.similarity >= other.similarity
        return self.similarity > other.similarity and (
            self.cycle_rotation_deg <= other.cycle_rotation_deg
        )


def label_free_score(
    registrar: Registrar,
    source: FrameSource,
    numbers: Sequence[int],
    gap: int,
    most: int,
    points: int,
    seed: int,
) -> LabelFreeScore:
    """Register the three pairs of triples of frames, each turned at random, from no guess.

    Args:
        registrar: that is judged.
        source: of the frames.
        numbers: of those that may take part.
        gap: from one frame of a triple to the next.
        most: triples, evenly spread.
        points: of each cloud.
        seed: of the turns and the draws.

    Raises:
        InvalidOptionError: the frames are too few for one triple.
    """
    starts = [number for number in numbers if number + 2 * gap in numbers]
    if not starts:
        raise InvalidOptionError(
            "too few frames are held back for one triple",
            field="held_out",
            value=f"{len(numbers)} frames, {gap} apart",
            mend="hold back more, or give a smaller gap",
        )
    places = np.unique(np.round(np.linspace(0, len(starts) - 1, most)).astype(int))
    framing = Framing(points=points, seed=seed)
    cycles, similarities, closed = [], [], 0
    for place in places:
        triple = [starts[int(place)] + gap * k for k in range(3)]
        clouds = [_turned(source, number, registrar, framing, seed) for number in triple]
        a, b, c = clouds
        results = [registrar.register(z, x, seed=seed) for x, z in ((a, b), (b, c), (a, c))]
        T_ab, T_bc, T_ac = (result.T_target_source for result in results)
        cycle = Cycle.of(T_ab, T_bc, T_ac)
        radius = float(np.linalg.norm(a - a.mean(axis=0), axis=1).max())
        closed += cycle.rotation_deg < _CLOSED_DEG and cycle.translation < _CLOSED_SHARE * radius
        cycles.append((cycle.rotation_deg, cycle.translation))
        similarities += [result.diagnostics.similarity for result in results]
    turn, shift = np.mean(cycles, axis=0)
    count = len(places)
    return LabelFreeScore(
        count, closed / count, float(np.mean(similarities)), float(turn), float(shift)
    )


def _turned(
    source: FrameSource, number: int, registrar: Registrar, framing: Framing, seed: int
) -> FloatArray:
    """A frame's points (n, 3) about a camera that is turned at random; the same every time."""
    seen = source.read(number, framing.candidates, seed + number)
    points = FramePreparer(registrar, framing).prepare(number, 0.0, seen).cloud.points
    R = _ANY_TURN.draw(torch_generator(seed, Stream.VALIDATION, number))[:3, :3]
    turned: FloatArray = points @ R.double().numpy().T
    return turned


class KeepIfBetter(Callback):
    """At the end of an adaptation, keeps the encoder only if held-back frames speak for it.

    The artifact goes into ``adapted`` in ``trainer.default_root_dir``, with ``verdict.json``
    beside it, which holds both scores. What was kept by an earlier run stays where this one fails.

    Args:
        gap: between the frames of a triple.
        triples: at most this many.
        points: of each cloud.
    """

    def __init__(self, gap: int = 45, triples: int = 30, points: int = 1024) -> None:
        self.gap = gap
        self.triples = triples
        self.points = points

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Judge, then write or say why not."""
        data = getattr(trainer, "datamodule", None)
        if not isinstance(data, TrackedData) or not trainer.is_global_zero or trainer.fast_dev_run:
            return
        before = load_artifact(data.artifact)
        after = adapted_artifact(before, pl_module, trainer.global_step)
        source, numbers = data.frames, data.held_out_numbers()
        scores = [
            label_free_score(
                Registrar(artifact), source, numbers, self.gap, self.triples, self.points, data.seed
            )
            for artifact in (before, after)
        ]
        folder = Path(trainer.default_root_dir)
        kept = scores[1].is_better_than(scores[0])
        if kept:
            save_artifact(after, folder / ADAPTED)
        verdict = {"kept": kept, "before": asdict(scores[0]), "after": asdict(scores[1])}
        folder.mkdir(parents=True, exist_ok=True)
        with complete_file(folder / VERDICT, "default_root_dir") as unfinished:
            unfinished.write_text(json.dumps(verdict, indent=2) + "\n", encoding="utf-8")
        _tell(scores[0], scores[1], folder / ADAPTED if kept else None)


def adapted_artifact(before: Artifact, module: LightningModule, steps: int) -> Artifact:
    """The artifact with a module's encoder, and all else as it was."""
    encoder = module.get_submodule("encoder")
    weights = {name: value.detach().cpu().clone() for name, value in encoder.state_dict().items()}
    training = {**before.training, "adapted_steps": steps, "adapted_from": before.name}
    return replace(
        before, name=f"{before.name}-adapted", weights=weights, training=training, weights_sha256=""
    )


def _tell(before: LabelFreeScore, after: LabelFreeScore, place: Path | None) -> None:
    console = Console(stderr=True, highlight=False)
    for name, score in (("before", before), ("after", after)):
        console.print(
            f"{name}: {score.closed:.0%} of {score.triples} loops close, ρ {score.similarity:.4f}, "
            f"mean gap {score.cycle_rotation_deg:.2f}° and {score.cycle_translation:.3g}",
            soft_wrap=True,
        )
    if place is None:
        console.print("Not kept: held-back frames don't speak for it. Use the artifact as it was.")
    else:
        console.print(f"Kept: {place}", soft_wrap=True)
