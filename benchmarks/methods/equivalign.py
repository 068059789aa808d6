"""Our method, and what is left of it when a part is taken away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from benchmarks.methods.method import Answer
from benchmarks.pair import FloatArray
from model import Diagnostics, Registrar
from model.artifact import Artifact
from model.encoder import build_encoder

_RANDOM_ENCODER_SEED = 1234


@dataclass(frozen=True, slots=True)
class EquivAlign:
    """A registrar with its settings.

    Attributes:
        name: of this variant.
        registrar: see model.Registrar.
        solver: the inner loop of the last stage; None for the artifact's.
        note: what makes the variant.
    """

    name: str
    registrar: Registrar
    solver: str | None = None
    note: str = "as shipped"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        summary = self.registrar.summary
        return {
            "variant": self.note,
            "artifact": summary["name"],
            "weights_sha256": summary["weights_sha256"],
            "solver": self.solver or self.registrar.artifact.settings.solver,
            "verifier": self.registrar.artifact.verifier is not None,
        }

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register."""
        result = self.registrar.register(source, target, seed=seed, solver=self.solver)
        others = [np.array(other.T_target_source) for other in result.diagnostics.runner_ups]
        return Answer(result.T_target_source, findings(result.diagnostics), others)


def findings(diagnostics: Diagnostics) -> dict[str, Any]:
    """What the results file keeps of the diagnostics."""
    kept: dict[str, Any] = {
        "similarity": diagnostics.similarity,
        "overlap_source": diagnostics.overlap_source,
        "converged": diagnostics.converged,
        "won_by": diagnostics.won_by,
        "iterations": diagnostics.iterations,
        "stages": {stage: round(s, 5) for stage, s in diagnostics.seconds.items()},
    }
    probability = getattr(diagnostics, "success_probability", None)
    if probability is not None:
        kept["success_probability"] = float(probability)
    return kept


def _as_shipped(artifact: Artifact) -> EquivAlign:
    return EquivAlign("ours", Registrar(artifact))


def _with_gradient_loop(artifact: Artifact) -> EquivAlign:
    return EquivAlign(
        "ours_gradient", Registrar(artifact), "gradient", "the paper's gradient loop at the end"
    )


def _with_procrustes_loop(artifact: Artifact) -> EquivAlign:
    return EquivAlign(
        "ours_procrustes",
        Registrar(artifact),
        "procrustes",
        "closed-form steps on the paper's kernel at the end",
    )


def without_features(artifact: Artifact) -> Artifact:
    """Surfaces alone: no hypotheses from features, none in the kernel, none in the judgement.

    A verifier is left out: it was fitted to features.
    """
    settings = artifact.settings
    unmatched = replace(settings.hypotheses, triplets=False, matches=0)
    bare = replace(settings, hypotheses=unmatched, surface_features=False)
    return replace(artifact, kernel="none", settings=bare, verifier=None)


def untrained(artifact: Artifact) -> Artifact:
    """The same encoder before any training, always the same one; without the verifier.

    That was fitted to the trained features.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(_RANDOM_ENCODER_SEED)
        weights = build_encoder(artifact.encoder_name, **artifact.architecture).state_dict()
    return replace(artifact, weights=weights, verifier=None)


def _without_features(artifact: Artifact) -> EquivAlign:
    return EquivAlign(
        "ours_no_features",
        Registrar(without_features(artifact)),
        note="surfaces alone, no features anywhere",
    )


def _with_random_encoder(artifact: Artifact) -> EquivAlign:
    return EquivAlign(
        "ours_random_encoder",
        Registrar(untrained(artifact)),
        note=f"weights never trained, seed {_RANDOM_ENCODER_SEED}",
    )


def _of_the_paper_alone(artifact: Artifact) -> EquivAlign:
    return EquivAlign(
        "ours_paper_bilevel",
        Registrar.load("paper_bilevel"),
        note="trained by the paper's loss and curriculum alone (configs/paper_bilevel.yaml)",
    )


VARIANTS: dict[str, Callable[[Artifact], EquivAlign]] = {
    "ours": _as_shipped,
    "ours_procrustes": _with_procrustes_loop,
    "ours_gradient": _with_gradient_loop,
    "ours_no_features": _without_features,
    "ours_random_encoder": _with_random_encoder,
    "ours_paper_bilevel": _of_the_paper_alone,
}
