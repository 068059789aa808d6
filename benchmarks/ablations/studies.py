"""The studies: the paper's four tables (section 5.3), and those that this method adds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.ablations.arm import Arm, both, one_start, search, with_hypotheses
from benchmarks.ablations.recipe import Recipe, Workshop
from benchmarks.methods.equivalign import untrained, without_features
from model.artifact import Artifact

# Those of the paper's ablation (b).
FIRST_LENGTHSCALES = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True, slots=True)
class Study:
    """A table.

    Attributes:
        name: in options and files.
        question: what it answers.
        arms: builds its rows from the artifact that ships and from trainings.
    """

    name: str
    question: str
    arms: Callable[[Artifact, Workshop], Sequence[Arm]]


def _trained(recipes: Sequence[tuple[str, Recipe]]) -> Callable[[Artifact, Workshop], list[Arm]]:
    def arms(shipped: Artifact, workshop: Workshop) -> list[Arm]:
        return [both(label, workshop.artifact(r), r.note) for label, r in recipes]

    return arms


_CONTRAST = Recipe("contrast", ["contrast"])
_CURRICULUM = Recipe("solved", ["contrast", "solved"])


def _contrast(name: str) -> Recipe:
    return Recipe(name, ["contrast", name])


def _solved(name: str) -> Recipe:
    return Recipe(name, ["contrast", "solved", name])


def _lengthscale(shipped: Artifact, workshop: Workshop) -> list[Arm]:
    return [
        Arm([one_start(f"ℓ = {ell:g}", shipped, "as shipped", ell)]) for ell in FIRST_LENGTHSCALES
    ]


def _encoder(shipped: Artifact, workshop: Workshop) -> list[Arm]:
    return [
        both("trained", shipped, "as shipped"),
        both("random encoder", untrained(shipped), "weights never trained"),
        both("no features", without_features(shipped), "surfaces alone"),
    ]


def _hypotheses(shipped: Artifact, workshop: Workshop) -> list[Arm]:
    changes: dict[str, dict[str, Any]] = {
        "all hypotheses": {},
        "without consensus": {"triplets": False},
        "without single matches": {"matches": 0},
        "without flips": {"flips": 0},
        "without grid": {"grid_step_deg": 0.0},
        "without identity": {"identity": False},
        "features alone": {"flips": 0, "grid_step_deg": 0.0, "identity": False},
        "grid alone": {"triplets": False, "matches": 0, "flips": 0, "identity": False},
    }
    return [
        Arm(search=[search(label, with_hypotheses(shipped, **change), label)])
        for label, change in changes.items()
    ]


STUDIES = {
    study.name: study
    for study in (
        Study(
            "kernel",
            "which kernel on the features",
            _trained(
                [
                    ("RBF × tanh(1 + s)", _CONTRAST),
                    ("RBF only", _contrast("kernel_none")),
                    ("RBF × (1 + tanh cos)", _contrast("kernel_tanh_cosine")),
                    ("RBF × exp(s)", _contrast("kernel_exponential")),
                ]
            ),
        ),
        Study("lengthscale", "which ℓ to start with, from one start", _lengthscale),
        Study(
            "curriculum",
            "whether small angles have to come first, where the loss sees only ĥ",
            _trained(
                [
                    ("curriculum 1, 10, 20, 30, 45°", _CURRICULUM),
                    ("45° directly", _solved("direct")),
                ]
            ),
        ),
        Study("encoder", "whether the encoder earns its place", _encoder),
        Study(
            "channels",
            "how many steerable vectors a point",
            _trained(
                [
                    ("4 channels", _contrast("channels_4")),
                    ("8 channels", _contrast("channels_8")),
                    ("16 channels", _CONTRAST),
                    ("32 channels", _contrast("channels_32")),
                ]
            ),
        ),
        Study("hypotheses", "which start poses are needed", _hypotheses),
        Study(
            "backward",
            "what of the inner loop the gradient sees, where the loss sees only ĥ",
            _trained(
                [
                    ("envelope", _CURRICULUM),
                    ("unrolled", _solved("unrolled")),
                    ("detached step", _solved("detached_step")),
                ]
            ),
        ),
    )
}
