"""The bi-level objectives that ``objectives`` compares, by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from training.bilevel import Backward

Encoder = Literal["none", "random", "trained"]


@dataclass(frozen=True, slots=True)
class Objective:
    """What an encoder is trained by.

    Attributes:
        name: in files and tables.
        loss: weight of each outer loss.
        backward: what of the inner loop the gradient sees.
        settings: arguments of single losses.
        encoder: ``none`` compares points alone and ``random`` doesn't train.
        learning_rate: of AdamW; None takes the study's.
        gated: weigh each pair by the solver's own ρ.
        kernel: name of the feature kernel, in training and in measuring; None takes the study's.
    """

    name: str
    loss: Mapping[str, float] = field(default_factory=dict)
    backward: Backward = "envelope"
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    encoder: Encoder = "trained"
    learning_rate: float | None = None
    gated: bool = False
    kernel: str | None = None


NO_FEATURES = "no features"
RANDOM = "random encoder"

_SMALL_RATE = 1e-3
_PAPERS = "tanh"

OBJECTIVES = {
    objective.name: objective
    for objective in (
        Objective(NO_FEATURES, encoder="none"),
        Objective(RANDOM, encoder="random"),
        Objective("argmin d, unrolled", {"rkhs_distance": 1.0}, "unrolled"),
        Objective("argmin d, envelope", {"rkhs_distance": 1.0}),
        Objective("argmin d, detached step", {"rkhs_distance": 1.0}, "detached_step"),
        Objective("released sign", {"rkhs_distance_released_sign": 1.0}, "detached_step"),
        Objective("1 − ρ", {"rkhs_cosine": 1.0}),
        Objective("ρ, self-terms detached", {"rkhs_cosine_detached": 1.0}),
        Objective("pose contrast at ĥ", {"pose_contrast_solved": 1.0}),
        Objective(
            "feature and pose contrast at ĥ",
            {"feature_contrast_solved": 1.0, "pose_contrast_solved": 1.0},
            gated=True,
        ),
        Objective(
            "argmin d, feature and pose contrast at ĥ",
            {"rkhs_distance": 1.0, "feature_contrast_solved": 1.0, "pose_contrast_solved": 1.0},
            gated=True,
        ),
        Objective(
            "feature and pose contrast at the self-made pose",
            {"feature_contrast": 1.0, "pose_contrast": 1.0},
        ),
        Objective("random encoder, paper's kernel", encoder="random", kernel=_PAPERS),
        Objective(
            "argmin d, unrolled, paper's kernel", {"rkhs_distance": 1.0}, "unrolled", kernel=_PAPERS
        ),
        Objective(
            "feature and pose contrast at ĥ, paper's kernel",
            {"feature_contrast_solved": 1.0, "pose_contrast_solved": 1.0},
            gated=True,
            kernel=_PAPERS,
        ),
        Objective("argmin d, small rate", {"rkhs_distance": 1.0}, learning_rate=_SMALL_RATE),
        Objective("argmin d, spread floor", {"rkhs_distance": 1.0, "spread_floor": 2.0}),
        Objective("feature contrast at ĥ", {"feature_contrast_solved": 1.0}),
    )
}
