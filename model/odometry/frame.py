"""From what a sensor saw to a cloud that can be registered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.exceptions import TooFewPointsError
from model.labels import sharp_colour_labels
from model.normalization import extent
from model.odometry.sensor import DepthNoise
from model.pair import PreparedTarget
from model.registration import Registrar
from model.sequence import FrameCloud, farthest_rows

FloatArray = npt.NDArray[np.float64]

# Farthest-point sampling sees this many candidates for every point that it keeps.
_CANDIDATES_PER_POINT = 10
# A frame whose extent differs more from the unit gets a unit of its own.
_UNIT_RATIO = 1.5


@dataclass(frozen=True, slots=True)
class Framing:
    """How a frame becomes a cloud.

    Attributes:
        points: of each cloud, spread evenly.
        least_points: a frame with fewer shows too little for a pose.
        noise: weighs points by their depth's noise; None weighs all alike.
        colour: compares colours as labels, too (paper, section 4.2).
        seed: of the draws.
    """

    points: int = 1024
    least_points: int = 200
    noise: DepthNoise | None = None
    colour: bool = False
    seed: int = 0

    @property
    def candidates(self) -> int:
        """Points of a frame that are worth reading."""
        return _CANDIDATES_PER_POINT * self.points


@dataclass(frozen=True, slots=True)
class OdometryFrame:
    """One frame, ready to be registered.

    Attributes:
        number: in its sequence.
        time: in seconds.
        cloud: prepared, as target or source.
    """

    number: int
    time: float
    cloud: PreparedTarget


class FramePreparer:
    """Thins, weighs, labels and encodes frames, all in one unit as long as that fits.

    Args:
        registrar: whose encoder.
        framing: see Framing.
        unit: of the frames so far, in the input's unit; None takes the first frame's extent.
    """

    def __init__(self, registrar: Registrar, framing: Framing, unit: float | None = None) -> None:
        self.registrar = registrar
        self.framing = framing
        self.unit = unit

    def prepare(self, number: int, time: float, seen: FrameCloud) -> OdometryFrame:
        """Make a frame ready.

        Args:
            number: of the frame.
            time: of the frame, in seconds.
            seen: candidates, in a random order or any other.

        Raises:
            TooFewPointsError: the frame shows too little.
            InvalidCloudError: its points have no pose.
        """
        framing = self.framing
        total = len(seen.points)
        if total < framing.least_points:
            raise TooFewPointsError(
                "the frame shows too little",
                field="frame",
                value=f"{total} points",
                mend=f"give frames with at least {framing.least_points} valid points",
            )
        rows = farthest_rows(seen.points, min(framing.points, total))
        points = np.ascontiguousarray(seen.points[rows])
        labels = None
        if framing.colour and seen.colours is not None:
            labels = sharp_colour_labels(seen.colours[rows])
        weights = None if framing.noise is None else framing.noise.weights(points[:, 2])
        self.unit = unit_for(points, self.unit)
        cloud = self.registrar.prepare(points, labels, framing.seed, weights, self.unit)
        return OdometryFrame(number, time, cloud)

    def in_unit_of(self, frame: OdometryFrame, other: OdometryFrame) -> OdometryFrame:
        """A frame in the unit of another one."""
        if frame.cloud.scale == other.cloud.scale:
            return frame
        cloud = frame.cloud
        again = self.registrar.prepare(
            cloud.points, cloud.labels, cloud.seed, cloud.weights, other.cloud.scale
        )
        return replace(frame, cloud=again)


def unit_for(points: FloatArray, unit: float | None) -> float:
    """The unit so far, or the points' (N, 3) own extent where the two differ too much."""
    own = extent(points - points.mean(axis=0))
    fits = unit is not None and own > 0.0 and 1.0 / _UNIT_RATIO <= own / unit <= _UNIT_RATIO
    return unit if fits and unit is not None else own
