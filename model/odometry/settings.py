"""When the tracker trusts an answer, and when it looks around."""

from __future__ import annotations

from dataclasses import dataclass

from model.exceptions import InvalidOptionError

MODES = ("keyframe", "frame")


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """When to trust an answer and when to look around.

    Attributes:
        mode: ``keyframe`` registers each frame to the latest keyframe, ``frame`` to the frame
            before it.
        keyframe_overlap: a frame that shares less than this with the keyframe becomes the next one.
        trusted: success probability from which a local answer is taken as it is; below, the frame
            is searched for everywhere.
        sufficient: what the answer of that must reach.
        doubtful: or this, if it also agrees with the predicted pose.
        least_overlap: below it the frame is lost, whatever else is said.
        agreement_deg: how far an answer may turn from the predicted pose and still agree.
        agreement_share: how far it may lie from it, in units of the frames' extent.
        keyframes: at most this many are kept.
        tried_when_lost: keyframes that a lost frame is searched against.
        restart_after: lost frames in a row after which the trajectory goes on from the guess.
        seed: of the searches.
    """

    mode: str = "keyframe"
    keyframe_overlap: float = 0.85
    trusted: float = 0.8
    sufficient: float = 0.6
    doubtful: float = 0.2
    least_overlap: float = 0.25
    agreement_deg: float = 6.0
    agreement_share: float = 0.05
    keyframes: int = 40
    tried_when_lost: int = 3
    restart_after: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InvalidOptionError(
                "unknown mode",
                field="mode",
                value=repr(self.mode),
                mend=f"choose one of {', '.join(MODES)}",
            )
        if not 0.0 < self.keyframe_overlap < 1.0:
            raise InvalidOptionError(
                "not a share",
                field="keyframe_overlap",
                value=self.keyframe_overlap,
                mend="give a number between 0 and 1",
            )
