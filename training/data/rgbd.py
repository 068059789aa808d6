"""Samples and pairs of the frames of RGB-D sequences."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.exceptions import TooFewPointsError
from model.sampling import farthest_point_sample
from model.sequence import Camera, Frame, RgbdSequence
from training.data.seeding import Stream, derived_seed, numpy_generator

Size = tuple[int, ...]

# Farthest-point sampling sees this many random candidates for every point that it keeps.
_CANDIDATES_PER_POINT = 10
_CACHED_CLOUDS = 4096


def sampled_cloud(
    sequence: RgbdSequence, number: int, points: int, seed: int, max_depth: float | None = None
) -> Tensor:
    """Farthest-point sample (points, 3) of a frame, float32; the same every time.

    Args:
        sequence: the frame's.
        number: of the frame.
        points: how many.
        seed: non-negative.
        max_depth: leave out what is farther away, in metres.

    Raises:
        UnreadableFileError: no depth image.
        TooFewPointsError: fewer pixels with depth.
    """
    return _sample_of(sequence, number, points, seed, max_depth)[0]


def sampled_colours(
    sequence: RgbdSequence, number: int, points: int, seed: int, max_depth: float | None = None
) -> Tensor:
    """Red, green and blue, 0 to 1, of the points that ``sampled_cloud`` gives, (points, 3).

    Raises:
        UnreadableFileError: no colour image, or one of other pixels.
        TooFewPointsError: fewer pixels with depth.
    """
    _, pixels, size = _sample_of(sequence, number, points, seed, max_depth)
    return torch.from_numpy(sequence.colours(number, size))[pixels]


def frame_pairs(frames: int, gap: int, limit: int = 1000) -> list[tuple[int, int]]:
    """Pairs (target, source) of frames ``gap`` apart, evenly spread when there are too many.

    Args:
        frames: number of frames.
        gap: source = target + gap, 1 or more.
        limit: most pairs to return.
    """
    targets = evenly_spread(max(0, frames - gap), limit)
    return [(int(target), int(target) + gap) for target in targets]


def evenly_spread(count: int, limit: int) -> npt.NDArray[np.int64]:
    """At most ``limit`` of the numbers below ``count``, first and last among them."""
    if count <= limit:
        return np.arange(count, dtype=np.int64)
    return np.round(np.linspace(0, count - 1, limit)).astype(np.int64)


def _sample_of(
    sequence: RgbdSequence, number: int, points: int, seed: int, max_depth: float | None
) -> tuple[Tensor, Tensor, Size]:
    path, place = sequence.frames[number].path, derived_seed(seed, number)
    return _sampled_frame(path, sequence.camera, points, place, max_depth)


@lru_cache(maxsize=_CACHED_CLOUDS)
def _sampled_frame(
    path: Path, camera: Camera, points: int, seed: int, max_depth: float | None
) -> tuple[Tensor, Tensor, Size]:
    """The sample (points, 3), its pixels (points,) row by row, and the image's size."""
    seen = RgbdSequence(path.parent, camera, [Frame(0.0, path, None)]).pixels(0, max_depth)
    if len(seen.points) < points:
        raise TooFewPointsError(
            f"the frame has {len(seen.points)} pixels with depth",
            field="points",
            value=f"{points} for {path}",
            mend="ask for fewer points, or leave this sequence out",
        )
    random = numpy_generator(seed, Stream.SAMPLING)
    count = min(len(seen.points), _CANDIDATES_PER_POINT * points)
    chosen = random.choice(len(seen.points), count, replace=False)
    candidates = torch.from_numpy(seen.points[chosen]).float()
    kept = farthest_point_sample(candidates, points, seed)
    return candidates[kept], torch.from_numpy(seen.pixels[chosen])[kept], seen.size
