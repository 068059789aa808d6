"""The inner loop alone, from one start: what the paper's method is without any search."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import nn

from benchmarks.methods.method import Answer
from benchmarks.methods.start import centroids_together
from benchmarks.pair import FloatArray
from model.artifact import Artifact
from model.cloud_function import CloudFunction
from model.inner_loop import GradientLoop, ProcrustesLoop
from model.kernel import RkhsKernel
from model.normalization import JointFrame
from model.se3 import rigid


@dataclass(frozen=True, slots=True)
class SingleStart:
    """Encode, then argmin over (h, ℓ) of d from centroid on centroid and no rotation.

    Attributes:
        name: in tables.
        kernel: of the RKHS.
        encoder: of the features; None for none.
        loop: in the unit sphere that holds both clouds.
        origin: where the weights come from, for the settings.
    """

    name: str
    kernel: RkhsKernel
    encoder: nn.Module | None
    loop: GradientLoop | ProcrustesLoop
    origin: dict[str, Any]

    @classmethod
    def of(
        cls, name: str, artifact: Artifact, loop: GradientLoop | ProcrustesLoop, note: str
    ) -> SingleStart:
        """With an artifact's encoder and kernel.

        Args:
            name: in tables.
            artifact: trained, or not.
            loop: from the start.
            note: what makes the variant.

        Raises:
            ArtifactFormatError: the weights don't fit the architecture.
        """
        encoder = artifact.encoder().requires_grad_(False)
        origin = {
            "variant": note,
            "artifact": artifact.name,
            "weights_sha256": artifact.weights_sha256,
        }
        return cls(name, RkhsKernel(artifact.kernel), encoder, loop, origin)

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        kernel = "RBF" if self.kernel.name == "none" else f"RBF × {self.kernel.name}"
        loop = {"loop": type(self.loop).__name__, **asdict(self.loop)}
        return {**self.origin, "kernel": kernel, "start": "centroids together", **loop}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        return self.register_from(source, target, centroids_together(source, target))

    def register_from(self, source: FloatArray, target: FloatArray, T: FloatArray) -> Answer:
        """From another start, T_target_source (4, 4)."""
        frame = JointFrame.of(target, source)
        T_start = frame.pose_in(T)
        with torch.no_grad():
            solution = self.loop.solve(
                self.kernel,
                self._function(frame.target(target)),
                self._function(frame.source(source)),
                torch.from_numpy(T_start).float()[None],
            )
        T = rigid(solution.T_target_source[0])
        # Loops that are told not to record leave no steps.
        steps = {"iterations": len(solution.steps)} if solution.steps else {}
        return Answer(frame.pose_out(T), {**steps, "converged": bool(solution.converged[0])})

    def _function(self, points: FloatArray) -> CloudFunction:
        x = torch.from_numpy(points).float()[None]
        return CloudFunction.of(x, None if self.encoder is None else self.encoder(x))
