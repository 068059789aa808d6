"""Geometric-CVO: the RKHS distance of the points alone, from one start, by gradient descent."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch

from benchmarks.methods.method import Answer
from benchmarks.methods.start import centroids_together
from benchmarks.pair import FloatArray
from model.cloud_function import CloudFunction
from model.inner_loop import GradientLoop
from model.kernel import RkhsKernel
from model.normalization import JointFrame


@dataclass(frozen=True, slots=True)
class GeometricCvo:
    """The paper's step rule with one fixed rate, and no features.

    Attributes:
        loop: the gradient descent, in the unit sphere that holds both clouds.
    """

    loop: GradientLoop = field(default_factory=GradientLoop)
    name: ClassVar[str] = "geometric_cvo"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"kernel": "RBF", "start": "centroids together", **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        frame = JointFrame.of(target, source)
        T_start = frame.pose_in(centroids_together(source, target))
        with torch.no_grad():
            solution = self.loop.solve(
                RkhsKernel("none"),
                _function(frame.target(target)),
                _function(frame.source(source)),
                torch.from_numpy(T_start).float()[None],
            )
        T = solution.T_target_source[0].double().numpy().copy()
        U, _, Vh = np.linalg.svd(T[:3, :3])
        T[:3, :3] = U @ Vh
        return Answer(
            frame.pose_out(T),
            {"iterations": len(solution.steps), "converged": bool(solution.converged[0])},
        )


def _function(points: FloatArray) -> CloudFunction:
    return CloudFunction.of(torch.from_numpy(points).float()[None])
