"""From small to large initial errors, one stage after another (paper, section 4.5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from model.exceptions import InvalidOptionError


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes:
        max_angle: largest initial rotation, in degrees.
        max_steps: the stage ends after this many optimiser steps whatever its success.
        success: share of validation pairs within 5° that ends the stage earlier; above 1 never.
        patience: the stage also ends when the success hasn't grown for this many validations.
        lengthscale: ℓ that the inner loop starts with.
        lengthscale_bounds: ℓ stays within.
        learning_rate: of the encoder.
        pose_learning_rate: of the pose in the gradient inner loop, in units of ℓ².
        lengthscale_rate_ratio: ℓ's rate is this much smaller (paper: 100).
    """

    max_angle: float
    max_steps: int = 1000
    success: float = 0.95
    patience: int = 5
    lengthscale: float = 0.25
    lengthscale_bounds: tuple[float, float] = (0.05, 2.0)
    learning_rate: float = 1e-3
    pose_learning_rate: float = 1.0
    lengthscale_rate_ratio: float = 100.0

    def __post_init__(self) -> None:
        if not 0.0 < self.max_angle <= 180.0:
            raise InvalidOptionError(
                "not an angle above 0 and up to 180 degrees",
                field="curriculum.max_angle",
                value=self.max_angle,
                mend="give degrees",
            )
        if self.max_steps < 1 or self.patience < 1:
            raise InvalidOptionError(
                "a stage needs at least one step and one validation",
                field="curriculum.max_steps, curriculum.patience",
                value=f"{self.max_steps}, {self.patience}",
                mend="give both as 1 or more",
            )


class Curriculum:
    """Where the training stands; its state goes into the checkpoint.

    Args:
        stages: in order; the last one goes on to the end of the training.

    Raises:
        InvalidOptionError: no stage.
    """

    def __init__(self, stages: Sequence[Stage]) -> None:
        if not stages:
            raise InvalidOptionError(
                "the curriculum is empty",
                field="curriculum",
                value=list(stages),
                mend="give at least one stage",
            )
        self.stages = list(stages)
        self.index = 0
        self.started_at = 0
        self.step = 0
        self.best_success = 0.0
        self.validations_without_growth = 0

    @property
    def stage(self) -> Stage:
        """The present stage."""
        return self.stages[self.index]

    @property
    def at_last(self) -> bool:
        """Whether no stage follows."""
        return self.index == len(self.stages) - 1

    def reach(self, step: int) -> bool:
        """Take the number of optimiser steps so far; tells whether the stage ended by it."""
        self.step = step
        return self._advance() if step - self.started_at >= self.stage.max_steps else False

    def judge(self, success: float) -> bool:
        """Take a validation's success (0 to 1); tells whether the stage ended by it."""
        if success > self.best_success:
            self.best_success, self.validations_without_growth = success, 0
        else:
            self.validations_without_growth += 1
        done = success >= self.stage.success
        stuck = self.validations_without_growth >= self.stage.patience
        return self._advance() if done or stuck else False

    def _advance(self) -> bool:
        if self.at_last:
            return False
        self.index += 1
        self.started_at = self.step
        self.best_success = 0.0
        self.validations_without_growth = 0
        return True

    def state_dict(self) -> dict[str, float]:
        """Position in the curriculum."""
        return {
            "index": self.index,
            "started_at": self.started_at,
            "best_success": self.best_success,
            "validations_without_growth": self.validations_without_growth,
        }

    def load_state_dict(self, state: dict[str, float]) -> None:
        """Go on from a saved position.

        Raises:
            InvalidOptionError: the saved stage doesn't exist in this curriculum.
        """
        if state["index"] >= len(self.stages):
            raise InvalidOptionError(
                "the checkpoint stands at a stage that this curriculum doesn't have",
                field="curriculum",
                value=f"stage {state['index'] + 1:g} of {len(self.stages)}",
                mend="resume with the configuration the checkpoint was made with",
            )
        self.index = int(state["index"])
        self.started_at = int(state["started_at"])
        self.best_success = float(state["best_success"])
        self.validations_without_growth = int(state["validations_without_growth"])
