"""What a trajectory is worth: counts, its own consistency, and errors against measured poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from model.odometry import AbsoluteError, RelativeError, Spread, Status, Step

FloatArray = npt.NDArray[np.float64]

GAPS = (1, 10, 30)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Of one trajectory.

    Attributes:
        counts: frames by status.
        keyframes: how many.
        cycles: (n, 2) degrees and lengths that loops of three registrations missed.
        measured: rows of ``steps`` that have a pose and a measured one.
        absolute: error of the whole trajectory; None without measured poses.
        relative: errors over gaps.
        seconds: that the tracking took.
        tracked_here: frames that were tracked in those seconds.
    """

    counts: dict[Status, int]
    keyframes: int
    cycles: FloatArray
    measured: npt.NDArray[np.int64]
    absolute: AbsoluteError | None
    relative: Sequence[RelativeError]
    seconds: float
    tracked_here: int

    @classmethod
    def of(
        cls,
        steps: Sequence[Step],
        truth: Sequence[FloatArray | None],
        seconds: float,
        tracked_here: int,
    ) -> Evaluation:
        """Compare.

        Args:
            steps: in their order.
            truth: T_world_camera (4, 4) of each, or None; its world is its own.
            seconds: that the tracking took.
            tracked_here: frames that were tracked in those seconds.
        """
        counts = {status: sum(step.status is status for step in steps) for status in Status}
        cycles = [step.cycle for step in steps if step.cycle is not None]
        rows, found, true = [], [], []
        for row, (step, T_true) in enumerate(zip(steps, truth, strict=True)):
            if T_true is not None and step.status.has_pose:
                rows.append(row)
                found.append(step.T_world_camera)
                true.append(T_true)
        T_found, T_true_all = (np.array(T).reshape(-1, 4, 4) for T in (found, true))
        gaps = (RelativeError.of(T_found, T_true_all, gap) for gap in GAPS)
        return cls(
            counts={status: count for status, count in counts.items() if count},
            keyframes=sum(step.keyframe for step in steps),
            cycles=np.array([(c.rotation_deg, c.translation) for c in cycles]).reshape(-1, 2),
            measured=np.array(rows, dtype=np.int64),
            absolute=AbsoluteError.of(T_found, T_true_all),
            relative=[error for error in gaps if error is not None],
            seconds=seconds,
            tracked_here=tracked_here,
        )

    @property
    def frames_per_second(self) -> float | None:
        """Of this run, reading included; None where nothing was tracked."""
        return self.tracked_here / self.seconds if self.tracked_here and self.seconds else None

    def lines(self) -> list[tuple[str, str]]:
        """In words, as (subject, statement)."""
        counted = ", ".join(f"{count} {status}" for status, count in self.counts.items())
        said = [("Frames", counted), ("Keyframes", str(self.keyframes))]
        if len(self.cycles):
            turn, shift = np.median(self.cycles, axis=0)
            said.append(
                (
                    "Cycle consistency",
                    f"{turn:.2f}° and {shift:.4g} (median of {len(self.cycles)} triples of frames)",
                )
            )
        if self.absolute is not None:
            ate = self.absolute.spread
            said.append(
                (
                    "ATE",
                    f"{ate.rmse:.4g} (root mean square; median {ate.median:.4g}, largest "
                    f"{ate.largest:.4g}) over {len(self.measured)} frames with measured poses",
                )
            )
        said += [(f"RPE, gap {error.gap}", _relative_words(error)) for error in self.relative]
        rate = self.frames_per_second
        if rate is not None:
            said.append(("Speed", f"{rate:.1f} frames a second ({self.seconds:.1f} s)"))
        return said

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        cycles = None
        if len(self.cycles):
            turn, shift = np.median(self.cycles, axis=0).tolist()
            cycles = {"triples": len(self.cycles), "rotation_deg": turn, "translation": shift}
        ate = None if self.absolute is None else _plain(self.absolute.spread)
        return {
            "frames": {status.value: count for status, count in self.counts.items()},
            "keyframes": self.keyframes,
            "cycle_consistency": cycles,
            "measured_poses": len(self.measured),
            "ate": ate,
            "rpe": [
                {
                    "gap": error.gap,
                    "rotation_deg": _plain(error.rotation_deg),
                    "translation": _plain(error.translation),
                }
                for error in self.relative
            ],
            "seconds": self.seconds,
            "frames_per_second": self.frames_per_second,
        }


def _relative_words(error: RelativeError) -> str:
    turn, shift = error.rotation_deg, error.translation
    return (
        f"{turn.mean:.3f}° ± {turn.std:.3f}° and {shift.mean:.4g} ± {shift.std:.4g} "
        f"(mean and standard deviation of {len(error.translations)} motions)"
    )


def _plain(spread: Spread) -> dict[str, float]:
    return {
        "mean": spread.mean,
        "std": spread.std,
        "median": spread.median,
        "rmse": spread.rmse,
        "max": spread.largest,
    }
