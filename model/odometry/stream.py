"""Frames in, steps out, one at a time: the next frame is read while this one is tracked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from model.exceptions import CloudFileError, InvalidCloudError
from model.odometry.frame import OdometryFrame
from model.odometry.step import Step
from model.odometry.tracker import Tracker
from model.sequence import FrameCloud, FrameSource

# Frames that are read ahead; each is some hundred kilobytes.
_AHEAD = 2


@dataclass(frozen=True, slots=True)
class Streamed:
    """A frame and what became of it.

    Attributes:
        step: see Step.
        seen: the points that were read, in the sensor's frame; None where none could be.
        unit: that the frame was prepared in; None where it wasn't.
    """

    step: Step
    seen: FrameCloud | None
    unit: float | None


@dataclass(frozen=True, slots=True)
class _Read:
    """A frame that was read, or why it wasn't."""

    frame: OdometryFrame | None
    seen: FrameCloud | None
    problem: str


def stream(source: FrameSource, numbers: Sequence[int], tracker: Tracker) -> Iterator[Streamed]:
    """Track frames in their order; a frame that can't be used is told of and left out.

    Args:
        source: where the frames are.
        numbers: of the frames, ascending.
        tracker: that follows them; it may have followed others before.

    Raises:
        InvalidOptionError: the calibration doesn't fit the images.
    """
    latest = None if tracker.motion is None else tracker.motion.time
    with ThreadPoolExecutor(max_workers=1) as pool:
        ahead: list[tuple[int, Future[_Read]]] = []
        waiting = iter(numbers)
        try:
            while True:
                while len(ahead) < _AHEAD and (number := next(waiting, None)) is not None:
                    ahead.append((number, pool.submit(_read, source, number, tracker)))
                if not ahead:
                    return
                number, reading = ahead.pop(0)
                read, time = reading.result(), source.time(number)
                if latest is not None and time <= latest:
                    problem = "its time isn't later than that of the frame before"
                    yield Streamed(tracker.skip(number, time, problem), None, None)
                    continue
                if read.frame is None:
                    yield Streamed(tracker.skip(number, time, read.problem), None, None)
                    continue
                latest = time
                yield Streamed(tracker.track(read.frame), read.seen, read.frame.cloud.scale)
        finally:
            for _, reading in ahead:
                reading.cancel()


def read_frame(
    source: FrameSource, number: int, tracker: Tracker
) -> tuple[OdometryFrame, FrameCloud]:
    """Read a frame and make it ready; the same every time.

    Raises:
        CloudFileError: its file can't be read.
        InvalidCloudError: it shows too little.
        InvalidOptionError: the calibration doesn't fit its image.
    """
    framing = tracker.preparer.framing
    # A seed of its own, lest all frames draw the same pixels.
    seen = source.read(number, framing.candidates, framing.seed + number)
    return tracker.preparer.prepare(number, source.time(number), seen), seen


def _read(source: FrameSource, number: int, tracker: Tracker) -> _Read:
    try:
        return _Read(*read_frame(source, number, tracker), "")
    except (CloudFileError, InvalidCloudError) as error:
        return _Read(None, None, str(error))
