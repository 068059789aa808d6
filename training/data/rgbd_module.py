"""Training on pairs of real depth frames, without their poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from model.exceptions import InvalidOptionError
from model.labels import colour_labels
from model.sequence import RgbdSequence, read_sequence
from training.data.module import STREAM, PairDataModule, Subset
from training.data.motion import Motion
from training.data.pairs import PairKey, RegistrationPair
from training.data.rgbd import evenly_spread, frame_pairs, sampled_cloud, sampled_colours
from training.data.seeding import Stream, torch_generator

# The paper's: on top of the camera's own motion.
EXTRA_ROTATION = Motion("uniform_angle", max_angle=10.0)


class FramePairs(Dataset[RegistrationPair]):
    """Pairs of frames of sequences, in metres, each in its own camera's frame.

    Args:
        sequences: where the frames come from.
        gaps: how many frames apart target and source are.
        points: of each cloud, chosen by farthest-point sampling.
        seed: non-negative.
        stream: keeps training, validation and test apart under one seed.
        shuffle: whether every epoch has its own order; otherwise all have the sequences' order.
        length: pairs in an epoch, evenly spread where not shuffled; None takes all.
        limit: most pairs of each sequence and gap.
        max_depth: leave out what is farther away, in metres.
        posed: take only pairs whose relative pose is known.
        colour: give the points' colours as labels.

    Raises:
        InvalidOptionError: no pairs.
    """

    def __init__(
        self,
        sequences: Sequence[RgbdSequence],
        gaps: Sequence[int],
        points: int,
        seed: int,
        stream: Stream,
        shuffle: bool,
        length: int | None = None,
        limit: int = 1000,
        max_depth: float | None = None,
        posed: bool = False,
        colour: bool = False,
    ) -> None:
        pairs = [
            (sequence, target, source)
            for sequence in sequences
            for gap in gaps
            for target, source in frame_pairs(len(sequence.frames), gap, limit)
            if not posed or sequence.relative_pose(target, source) is not None
        ]
        if not pairs:
            raise InvalidOptionError(
                "these sequences have no such pairs" + (" with known poses" if posed else ""),
                field="gaps",
                value=f"{list(gaps)} in {', '.join(s.name for s in sequences) or 'no sequence'}",
                mend="give longer sequences, with groundtruth.txt where poses are measured against",
            )
        if length is not None and not shuffle:
            pairs = [pairs[i] for i in evenly_spread(len(pairs), length)]
        self.pairs = pairs
        self.points = points
        self.seed = seed
        self.stream = stream
        self.shuffle = shuffle
        self.length = len(pairs) if length is None or not shuffle else length
        self.max_depth = max_depth
        self.colour = colour

    def __len__(self) -> int:
        return self.length

    def __getitem__(self, key: PairKey) -> RegistrationPair:
        """The pair before the extra rotation; an unknown pose is NaN, so no metric can pass it."""
        sequence, target, source = self.pairs[self._place(key)]
        T = sequence.relative_pose(target, source)
        sampling = (self.points, self.seed, self.max_depth)
        labels = [
            _labels(sampled_colours(sequence, number, *sampling)) if self.colour else None
            for number in (target, source)
        ]
        return RegistrationPair(
            sampled_cloud(sequence, target, *sampling),
            sampled_cloud(sequence, source, *sampling),
            torch.from_numpy(np.full((4, 4), np.nan) if T is None else T).float(),
            False,
            f"{sequence.name}/{target}-{source}",
            key.number,
            target_labels=labels[0],
            source_labels=labels[1],
        )

    def _place(self, key: PairKey) -> int:
        if not self.shuffle:
            return key.number
        through, place = divmod(key.epoch * self.length + key.number, len(self.pairs))
        generator = torch_generator(self.seed, self.stream, Stream.ORDER, through)
        return int(torch.randperm(len(self.pairs), generator=generator)[place])


def _labels(colours: Tensor) -> Tensor:
    return torch.from_numpy(colour_labels(colours.numpy())).float()


class RgbdData(PairDataModule):
    """Pairs of frames of RGB-D sequences, a few frames apart, with an extra random rotation.

    Poses from ``groundtruth.txt`` are for metrics alone; training needs none.

    Args:
        train: folders of the sequences to train on.
        val: those to validate on; their poses must be known.
        test: those to test on; their poses must be known.
        gaps: how many frames apart the two clouds of a pair are.
        points: of each cloud, chosen by farthest-point sampling.
        pairs_per_epoch: length of a training epoch; None takes all pairs once.
        evaluation_pairs: number of validation pairs, and of test pairs, evenly spread; None takes
            all.
        pairs_per_sequence: most pairs of each sequence and gap, evenly spread.
        max_depth: leave out what is farther away, in metres.
        colour: compare the frames' colours as labels l(x), too; the paper sets l = 1.
        motion: the law of the extra rotation, about the source's camera.
        **options: as for ``PairDataModule``.
    """

    def __init__(
        self,
        train: Sequence[Path] = (),
        val: Sequence[Path] = (),
        test: Sequence[Path] = (),
        gaps: Sequence[int] = (1,),
        points: int = 1024,
        pairs_per_epoch: int | None = None,
        evaluation_pairs: int | None = None,
        pairs_per_sequence: int = 1000,
        max_depth: float | None = None,
        colour: bool = False,
        motion: Motion | None = None,
        **options: Any,
    ) -> None:
        super().__init__(motion=motion or EXTRA_ROTATION, **options)
        self.folders: dict[Subset, Sequence[Path]] = {"train": train, "val": val, "test": test}
        if not gaps or min(gaps) < 1 or points < 4 or pairs_per_sequence < 1:
            raise InvalidOptionError(
                "gaps and pairs need to be 1 or more, points 4 or more",
                field="gaps, points, pairs_per_sequence",
                value=f"{list(gaps)}, {points}, {pairs_per_sequence}",
                mend="give greater numbers",
            )
        self.gaps = tuple(gaps)
        self.points = points
        self.pairs_per_epoch = pairs_per_epoch
        self.evaluation_pairs = evaluation_pairs
        self.pairs_per_sequence = pairs_per_sequence
        self.max_depth = max_depth
        self.colour = colour

    def pairs(self, subset: Subset) -> FramePairs:
        """The pairs of one subset before the extra rotation.

        Raises:
            InvalidOptionError: no sequences for it, or no pairs in them.
            UnreadableFileError: a sequence isn't of the layout.
        """
        folders = self.folders[subset]
        if not folders:
            raise InvalidOptionError(
                "no sequences for this", field=subset, value=[], mend="give folders of sequences"
            )
        training = subset == "train"
        return FramePairs(
            [read_sequence(Path(folder)) for folder in folders],
            self.gaps,
            self.points,
            self.seed,
            STREAM[subset],
            shuffle=training,
            length=self.pairs_per_epoch if training else self.evaluation_pairs,
            limit=self.pairs_per_sequence,
            max_depth=self.max_depth,
            posed=not training,
            colour=self.colour,
        )
