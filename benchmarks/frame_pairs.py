"""Pairs of real depth frames of one sequence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from benchmarks.pair import BenchmarkPair, FloatArray, PairEntry, orthonormal
from model.exceptions import InvalidOptionError
from model.sequence import RgbdSequence
from training.data.motion import Motion
from training.data.rgbd import evenly_spread, sampled_cloud
from training.data.seeding import Stream, derived_seed, torch_generator

# Exactly this angle about an axis anywhere through the source's camera.
EXTRA_ROTATION_DEG = 10.0
COLUMNS = {
    "as-is": Motion("exact_angle", 0.0),
    "extra-10": Motion("exact_angle", EXTRA_ROTATION_DEG),
    "extra-60": Motion("exact_angle", 60.0),
}
# The paper's; the third is asked for by name.
DEFAULT_COLUMNS = ("as-is", "extra-10")


def list_frame_pairs(
    sequence: RgbdSequence,
    frames: range | None,
    gaps: Sequence[int],
    columns: Sequence[str],
    limit: int | None,
    seed: int,
) -> list[PairEntry]:
    """All pairs of frames so far apart, each as it is and with the extra rotation.

    Args:
        sequence: whose poses are known.
        frames: the numbers of those that take part, both of a pair; None takes all whose poses
            are known.
        gaps: source = target + gap.
        columns: of ``COLUMNS``.
        limit: most pairs of a gap, evenly spread; None takes all.
        seed: non-negative.

    Raises:
        InvalidOptionError: frames or columns that don't exist, unknown poses, or no pairs at all.
    """
    unknown = [name for name in columns if name not in COLUMNS]
    if unknown or not gaps or min(gaps) < 1:
        raise InvalidOptionError(
            "no such columns or gaps",
            field="columns, gaps",
            value=f"{', '.join(columns)}; {list(gaps)}",
            mend=f"choose from {', '.join(COLUMNS)}, and give gaps of 1 or more",
        )
    if frames is not None:
        _require_frames(sequence, frames)
    entries = []
    for gap in gaps:
        targets = _targets(sequence, frames, gap)
        for place in evenly_spread(len(targets), len(targets) if limit is None else limit):
            target = targets[int(place)]
            entries += [_entry(sequence, target, gap, column, seed) for column in columns]
    if not entries:
        raise InvalidOptionError(
            "no frames with known poses are that far apart",
            field="gaps",
            value=f"{list(gaps)} in {sequence.name}",
            mend="give more frames or smaller gaps",
        )
    return entries


def _targets(sequence: RgbdSequence, frames: range | None, gap: int) -> list[int]:
    chosen = range(len(sequence.frames)) if frames is None else frames
    return [
        target
        for target in chosen
        if target + gap in chosen and sequence.relative_pose(target, target + gap) is not None
    ]


def _require_frames(sequence: RgbdSequence, frames: range) -> None:
    total = len(sequence.frames)
    if len(frames) == 0 or not 0 <= frames[0] <= frames[-1] < total:
        raise InvalidOptionError(
            "no such frames",
            field="frames",
            value=f"{frames.start}–{frames.stop - 1}",
            mend=f"{sequence.name} has the frames 0–{total - 1}",
        )
    unposed = [number for number in frames if sequence.frames[number].T_world_camera is None]
    if unposed:
        raise InvalidOptionError(
            f"the poses of {len(unposed)} frames aren't known",
            field="frames",
            value=f"the first is {unposed[0]}",
            mend="give frames with a pose in groundtruth.txt",
        )


def _entry(sequence: RgbdSequence, target: int, gap: int, column: str, seed: int) -> PairEntry:
    return PairEntry(
        name=f"{column}/gap{gap}/{sequence.name}-{target:05d}",
        column=column,
        turn=f"gap {gap}",
        subject=target,
        subject_name=f"{sequence.name}/{target}-{target + gap}",
        group=sequence.name,
        seed=derived_seed(seed, Stream.TEST, target, gap) % 2**31,
    )


@dataclass(frozen=True, slots=True)
class FramePairMaker:
    """Makes the arrays of a listed pair, in metres.

    Attributes:
        sequence: the frames.
        points: of each cloud, by farthest-point sampling; None takes every pixel with depth.
        seed: of the sampling.
        max_depth: leaves out what is farther away, in metres; None leaves out nothing.
    """

    sequence: RgbdSequence
    points: int | None
    seed: int
    max_depth: float | None = None

    def make(self, entry: PairEntry) -> BenchmarkPair:
        """The same arrays for the same entry.

        Raises:
            TooFewPointsError: a frame with fewer pixels with depth.
            UnreadableFileError: no depth image.
        """
        target = entry.subject
        source = target + int(entry.turn.removeprefix("gap "))
        T_measured = self.sequence.relative_pose(target, source)
        if T_measured is None:
            raise InvalidOptionError("its pose isn't known", field="frames", value=entry.name)
        motion = COLUMNS[entry.column]
        extra = orthonormal(motion.draw(torch_generator(entry.seed, Stream.MOTION))).numpy()
        still = self._cloud(source)
        return BenchmarkPair(
            entry,
            (still - extra[:3, 3]) @ extra[:3, :3],
            self._cloud(target),
            orthonormal(torch.from_numpy(T_measured)).numpy() @ extra,
            None,
        )

    def _cloud(self, number: int) -> FloatArray:
        if self.points is None:
            return self.sequence.cloud(number, self.max_depth)
        sample = sampled_cloud(self.sequence, number, self.points, self.seed, self.max_depth)
        return sample.double().numpy()
