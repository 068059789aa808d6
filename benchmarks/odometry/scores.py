"""Tables of trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.figures import decimals
from benchmarks.odometry.followers import Followed, SampledFrame
from benchmarks.odometry.residual import HeldOutSurface
from benchmarks.sheet import Sheet
from model.odometry import AbsoluteError, RelativeError

GAPS = (1, 10)
_MILLI = 1000.0


@dataclass(frozen=True, slots=True)
class TrajectoryScore:
    """One follower on one sequence in one mode.

    Attributes:
        absolute: ATE.
        relative: RPE by gap.
        residual: mean over neighbouring frames of the label-free residual, in metres.
        lost: frames without a trusted pose.
        frames_per_second: of one thread, reading left out; None where nobody timed.
    """

    absolute: AbsoluteError
    relative: Mapping[int, RelativeError]
    residual: float
    lost: int
    frames_per_second: float | None

    @classmethod
    def of(
        cls,
        followed: Followed,
        frames: Sequence[SampledFrame],
        surfaces: Sequence[HeldOutSurface],
    ) -> TrajectoryScore:
        """Score at least 2 frames."""
        T, T_true = followed.T_world_camera, np.array([frame.T_world_camera for frame in frames])
        absolute = AbsoluteError.of(T, T_true)
        assert absolute is not None
        found = ((gap, RelativeError.of(T, T_true, gap)) for gap in GAPS)
        residuals = [
            surfaces[k].residual(surfaces[k + 1], np.linalg.inv(T[k]) @ T[k + 1])
            for k in range(len(T) - 1)
        ]
        return cls(
            absolute,
            {gap: error for gap, error in found if error is not None},
            float(np.nanmean(residuals)),
            followed.lost,
            # The first frame is only prepared, and libraries load then.
            1.0 / float(np.mean(followed.seconds[1:])) if followed.seconds else None,
        )

    def cells(self) -> list[str]:
        """As a row, millimetres and degrees."""
        ate = self.absolute.spread
        row = [decimals(_MILLI * ate.rmse, 1), decimals(_MILLI * ate.largest, 1)]
        for gap in GAPS:
            error = self.relative.get(gap)
            if error is None:
                row += ["–"] * 4
                continue
            turn, shift = error.rotation_deg, error.translation
            row += [decimals(turn.mean, 3), decimals(turn.std, 3)]
            row += [decimals(_MILLI * shift.mean, 2), decimals(_MILLI * shift.std, 2)]
        row.append(decimals(_MILLI * self.residual, 3))
        return [*row, str(self.lost), decimals(self.frames_per_second, 1)]


def trajectory_sheet(
    sequence: str, mode: str, frames: int, scores: Mapping[str, TrajectoryScore]
) -> Sheet:
    """All followers on one sequence in one mode."""
    head = ["method", "ATE rmse mm", "largest"]
    for gap in GAPS:
        head += [f"RPE {gap} mean °", "std", "mean mm", "std"]
    head += ["residual mm", "lost", "frames/s"]
    return Sheet(
        f"{sequence}, {frames} frames, {mode}",
        head,
        [[name, *score.cells()] for name, score in scores.items()],
        note="residual: median height of held-out pixels above the surface of the frame before; "
        "it needs no measured pose, and the row measured shows that of the measured poses",
    )
