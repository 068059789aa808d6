"""Adaptation to one scene: pairs of a sequence's frames, with the poses that odometry found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.data import Dataset

from model import Registrar
from model.exceptions import InvalidOptionError
from model.odometry import FramePreparer, Framing, Step, Tracker, stream
from model.sequence import FrameSource, open_frames
from training.data.loader import PairLoader
from training.data.module import PairDataModule, Subset
from training.data.motion import Motion
from training.data.pairs import PairKey, RegistrationPair
from training.data.seeding import Stream, torch_generator

FloatArray = npt.NDArray[np.float64]

# Pairs are turned at random: nothing in the scene may count on an upright camera.
ANY_ROTATION = Motion("haar", 180.0)


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """One frame with ĥ.

    Attributes:
        number: in its sequence.
        points: (n, 3) evenly spread.
        T_world_camera: (4, 4) that odometry found; never a measured pose.
        piece: frames of different pieces have no pose between them: tracking was lost or doubtful.
    """

    number: int
    points: FloatArray
    T_world_camera: FloatArray
    piece: int


def tracked_frames(
    source: FrameSource, numbers: Sequence[int], registrar: Registrar, points: int, seed: int
) -> list[TrackedFrame]:
    """Follow the camera; frames without a trusted pose are left out and end a piece.

    Args:
        source: of the frames.
        numbers: of those to follow, ascending.
        registrar: that follows.
        points: of each cloud.
        seed: of the draws.
    """
    tracker = Tracker(FramePreparer(registrar, Framing(points=points, seed=seed)))
    frames, piece = [], 0
    for streamed in stream(source, numbers, tracker):
        step = streamed.step
        if not _trusted(step) or tracker.previous is None:
            piece += 1
            continue
        cloud = tracker.previous.frame.cloud
        frames.append(TrackedFrame(step.number, cloud.points, step.T_world_camera, piece))
    return frames


def _trusted(step: Step) -> bool:
    return step.status.has_pose and not step.warning


class TrackedPairs(Dataset[RegistrationPair]):
    """Pairs of tracked frames some numbers apart.

    Args:
        frames: of one sequence.
        gaps: of the pairs, in places of the list; drawn evenly.
        length: pairs in an epoch.
        seed: non-negative.
        stream: keeps training, validation and test apart under one seed.

    Raises:
        InvalidOptionError: no two frames of a piece are that far apart.
    """

    def __init__(
        self,
        frames: Sequence[TrackedFrame],
        gaps: Sequence[int],
        length: int,
        seed: int,
        stream: Stream,
    ) -> None:
        self.frames = frames
        self.length = length
        self.seed = seed
        self.stream = stream
        self.by_gap = [
            [i for i in range(len(frames) - gap) if frames[i].piece == frames[i + gap].piece]
            for gap in gaps
        ]
        self.gaps = gaps
        if not any(self.by_gap):
            raise InvalidOptionError(
                "no two tracked frames are that far apart",
                field="gaps",
                value=f"{list(gaps)} with {len(frames)} tracked frames",
                mend="give a longer sequence or smaller gaps",
            )

    def __len__(self) -> int:
        return self.length

    def __getitem__(self, key: PairKey) -> RegistrationPair:
        """The pair with ĥ between its frames; losses that use only ĥ may see it."""
        generator = torch_generator(self.seed, self.stream, Stream.PAIR, *key)
        choices = [number for number, starts in enumerate(self.by_gap) if starts]
        chosen = choices[int(torch.randint(len(choices), (1,), generator=generator))]
        starts = self.by_gap[chosen]
        first = starts[int(torch.randint(len(starts), (1,), generator=generator))]
        target, source = self.frames[first], self.frames[first + self.gaps[chosen]]
        T = np.linalg.inv(target.T_world_camera) @ source.T_world_camera
        return RegistrationPair(
            torch.from_numpy(target.points).float(),
            torch.from_numpy(source.points).float(),
            torch.from_numpy(T).float(),
            False,
            f"{target.number}-{source.number}",
            key.number,
        )


class TrackedData(PairDataModule):
    """Pairs of one sequence, tracked first by the artifact that is adapted.

    No measured pose is read. The sequence's end is held back, to judge the outcome by.

    Args:
        root: folder of the sequence, as for ``equivalign odometry``.
        artifact: that tracks; the shipped one when left out.
        gaps: how many frames apart the two clouds of a pair are.
        points: of each cloud.
        pairs_per_epoch: length of a training epoch.
        held_out: share of the frames, at the sequence's end, that no training pair sees.
        max_depth: leave out what is farther away, in metres.
        motion: the law of the source's random turn, about its camera.
        **options: as for ``PairDataModule``.
    """

    def __init__(
        self,
        root: Path,
        artifact: str | None = None,
        gaps: Sequence[int] = (10, 30, 60),
        points: int = 560,
        pairs_per_epoch: int = 100_000,
        held_out: float = 0.3,
        max_depth: float | None = None,
        motion: Motion | None = None,
        **options: Any,
    ) -> None:
        super().__init__(motion=motion or ANY_ROTATION, **options)
        if not gaps or min(gaps) < 1 or not 0.0 < held_out < 1.0:
            raise InvalidOptionError(
                "gaps need to be 1 or more, the share that is held out between 0 and 1",
                field="gaps, held_out",
                value=f"{list(gaps)}, {held_out}",
                mend="give such numbers",
            )
        self.root = Path(root)
        self.artifact = artifact
        self.gaps = tuple(gaps)
        self.points = points
        self.pairs_per_epoch = pairs_per_epoch
        self.held_out = held_out
        self.max_depth = max_depth
        self._tracked: list[TrackedFrame] | None = None

    @property
    def frames(self) -> FrameSource:
        """The whole sequence."""
        return open_frames(self.root, self.max_depth)

    def held_out_numbers(self) -> range:
        """Frames that no training pair sees."""
        total = len(self.frames)
        return range(total - max(1, round(self.held_out * total)), total)

    def pairs(self, subset: Subset) -> TrackedPairs:
        """The training pairs; tracking them takes a tenth of a second a frame.

        Raises:
            InvalidOptionError: another subset, or no pairs.
        """
        if subset != "train":
            raise InvalidOptionError(
                "a tracked sequence has pairs for training alone: nothing is known to validate by",
                field=subset,
                mend="measure with `equivalign odometry` or `equivalign benchmark odometry`",
            )
        if self._tracked is None:
            numbers = range(self.held_out_numbers().start)
            registrar = Registrar.load(self.artifact)
            self._tracked = tracked_frames(self.frames, numbers, registrar, self.points, self.seed)
        length = self.pairs_per_epoch
        return TrackedPairs(self._tracked, self.gaps, length, self.seed, Stream.TRAINING)

    def val_dataloader(self) -> PairLoader | list[None]:  # type: ignore[override]
        """None: the outcome is judged without labels, see ``training.adaptation``."""
        return []
