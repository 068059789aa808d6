"""Odometry: each frame registered to a keyframe from a predicted pose; lost, it looks around."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.odometry.answer import Answer
from model.odometry.consistency import Cycle
from model.odometry.frame import FramePreparer, OdometryFrame
from model.odometry.keyframes import Keyframe, Keyframes
from model.odometry.motion import ConstantVelocity
from model.odometry.settings import TrackerSettings
from model.odometry.step import Status, Step

FloatArray = npt.NDArray[np.float64]

# A local answer turns no farther from its guess: beyond, the guess said nothing.
_LOCAL_REACH_DEG = 45.0


class Tracker:
    """Follows a camera frame by frame; the first frame's camera is the world.

    Args:
        preparer: that the frames come from.
        settings: see TrackerSettings.
    """

    def __init__(self, preparer: FramePreparer, settings: TrackerSettings | None = None) -> None:
        self.settings = settings or TrackerSettings()
        self.preparer = preparer
        self.keyframes = Keyframes(self.settings.keyframes)
        self.motion: ConstantVelocity | None = None
        self.lost_in_a_row = 0
        self._previous: Keyframe | None = None

    @property
    def previous(self) -> Keyframe | None:
        """The last frame with a pose."""
        return self._previous

    def track(self, frame: OdometryFrame) -> Step:
        """Find a frame's pose.

        Args:
            frame: later than all before it.
        """
        if self.motion is None:
            return self._begin(frame, Status.FIRST, np.eye(4))
        guess = self.motion.predict(frame.time)
        local = self._local(frame, guess)
        if local.is_trusted(self.settings):
            status = Status.RELOCALISED if self.lost_in_a_row else Status.TRACKED
            return self._follow(frame, local, status)
        # A search that knows the rivals judges better than a local one; it starts there, too.
        best = self._around(frame, local.T_world_camera)
        # After a loss the prediction is no witness.
        expected = None if self.lost_in_a_row else guess
        if not best.is_believable(self.settings, expected, frame.cloud.scale):
            return self._lose(frame, guess)
        moved_on = expected is not None and best.agrees(self.settings, guess, frame.cloud.scale)
        return self._follow(frame, best, Status.TRACKED if moved_on else Status.RELOCALISED)

    def skip(self, number: int, time: float, reason: str) -> Step:
        """Record a frame that can't be read; the camera is thought to go on as it did."""
        T = np.eye(4) if self.motion is None else self.motion.predict(time)
        return Step(
            number=number, time=time, status=Status.UNREADABLE, T_world_camera=T, warning=reason
        )

    def resume(
        self,
        keyframes: list[Keyframe],
        previous: Keyframe,
        motion: ConstantVelocity,
        lost_in_a_row: int,
    ) -> None:
        """Go on where another tracker stopped.

        Args:
            keyframes: in their order.
            previous: the last frame with a pose.
            motion: so far.
            lost_in_a_row: frames lost since then.
        """
        for keyframe in keyframes:
            self.keyframes.add(keyframe)
        self._previous, self.motion, self.lost_in_a_row = previous, motion, lost_in_a_row

    def _begin(
        self, frame: OdometryFrame, status: Status, T: FloatArray, warning: str = ""
    ) -> Step:
        keyframe = Keyframe(frame, T)
        self.keyframes.add(keyframe)
        self._previous = keyframe
        self.motion = ConstantVelocity(frame.time, T)
        self.lost_in_a_row = 0
        return Step(
            number=frame.number,
            time=frame.time,
            status=status,
            T_world_camera=T,
            keyframe=True,
            warning=warning,
        )

    def _references(self) -> list[Keyframe]:
        """The keyframe, and the frame before this one where that is another."""
        latest, previous = self.keyframes.latest, self._previous
        if previous is None or previous.frame.number == latest.frame.number:
            return [latest]
        return [latest, previous]

    def _local(self, frame: OdometryFrame, guess: FloatArray) -> Answer:
        """From the predicted pose to the keyframe; in doubt also from no motion, and to the last
        frame. The best by its probability.
        """
        best: Answer | None = None
        assert self.motion is not None
        for keyframe in self._references():
            for T_guess in (guess, self.motion.T_world_camera):
                answer = self._registered(frame, keyframe, T_guess, "local")
                if answer.is_trusted(self.settings):
                    return answer
                if best is None or answer.probability > best.probability:
                    best = answer
        assert best is not None
        return best

    def _registered(
        self, frame: OdometryFrame, keyframe: Keyframe, T_world_guess: FloatArray, search: str
    ) -> Answer:
        """From a guess of the pose in the world, near it or everywhere."""
        fixed = self.preparer.in_unit_of(keyframe.frame, frame)
        result = self.preparer.registrar.register(
            frame.cloud,
            fixed.cloud,
            initial=np.linalg.inv(keyframe.T_world_camera) @ T_world_guess,
            max_rotation_deg=_LOCAL_REACH_DEG if search == "local" else 180.0,
            search=search,
            seed=self.settings.seed,
        )
        return Answer(keyframe, result, keyframe.T_world_camera @ result.T_target_source)

    def _around(self, frame: OdometryFrame, guess: FloatArray) -> Answer:
        """Search everywhere against a few keyframes, until one of the answers is trusted."""
        assert self.motion is not None
        near = self.keyframes.near(self.motion.T_world_camera)
        latest = self._references() if not self.lost_in_a_row else []
        seen = {keyframe.frame.number for keyframe in latest}
        others = [keyframe for keyframe in near if keyframe.frame.number not in seen]
        answers = []
        for keyframe in [*latest, *others][: self.settings.tried_when_lost]:
            answers.append(self._registered(frame, keyframe, guess, "global"))
            if answers[-1].is_trusted(self.settings):
                break
        return max(answers, key=lambda answer: answer.probability)

    def _lose(self, frame: OdometryFrame, guess: FloatArray) -> Step:
        self.lost_in_a_row += 1
        if self.lost_in_a_row > self.settings.restart_after:
            said = (
                f"lost for {self.lost_in_a_row - 1} frames; the trajectory goes on from where the "
                "motion model guesses the camera"
            )
            return self._begin(frame, Status.RESTARTED, guess, said)
        return Step(
            number=frame.number,
            time=frame.time,
            status=Status.LOST,
            T_world_camera=guess,
            warning="lost: no keyframe agrees with this frame",
        )

    def _follow(self, frame: OdometryFrame, answer: Answer, status: Status) -> Step:
        assert self.motion is not None
        T = answer.T_world_camera
        if status is Status.TRACKED and not self.lost_in_a_row:
            self.motion = self.motion.moved(frame.time, T)
        else:
            self.motion = self.motion.restarted(frame.time, T)
        self.lost_in_a_row = 0
        is_key = self._becomes_keyframe(frame, answer)
        cycle = self._cycle(frame, answer) if is_key and self.settings.mode == "keyframe" else None
        self._previous = Keyframe(frame, T)
        if is_key:
            self.keyframes.add(self._previous)
        d = answer.result.diagnostics
        return Step(
            number=frame.number,
            time=frame.time,
            status=status,
            T_world_camera=T,
            reference=answer.keyframe.frame.number,
            success_probability=d.success_probability,
            overlap=answer.overlap,
            rmse=d.inlier_rmse,
            keyframe=is_key,
            cycle=cycle,
            warning=""
            if answer.probability >= self.settings.sufficient
            else f"doubtful: success probability {answer.probability:.2f}",
        )

    def _becomes_keyframe(self, frame: OdometryFrame, answer: Answer) -> bool:
        other_unit = answer.keyframe.frame.cloud.scale != frame.cloud.scale
        scarce = min(answer.overlap, answer.result.diagnostics.overlap_target)
        return (
            self.settings.mode == "frame" or other_unit or scarce < self.settings.keyframe_overlap
        )

    def _cycle(self, frame: OdometryFrame, answer: Answer) -> Cycle | None:
        """Keyframe → last frame → this frame → keyframe, where the last frame is in between."""
        between = self._previous
        if between is None or between.frame.number == answer.keyframe.frame.number:
            return None
        step = self._registered(frame, between, answer.T_world_camera, "local")
        T_key_between = np.linalg.inv(answer.keyframe.T_world_camera) @ between.T_world_camera
        return Cycle.of(T_key_between, step.result.T_target_source, answer.result.T_target_source)
