"""GICP as the small_gicp package does it; it is optional."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, ClassVar

import numpy as np
import small_gicp

from benchmarks.methods.method import Answer
from benchmarks.methods.open3d_cloud import open3d_cloud, spacing
from benchmarks.methods.start import centroids_together
from benchmarks.pair import FloatArray


@dataclass(frozen=True, slots=True)
class SmallGicp:
    """Point-to-point steps that reach far, then GICP.

    Attributes:
        point_reach: correspondence distances of the point-to-point stages, in spacings.
        reach: those of GICP's stages.
        neighbours: of a point's covariance.
        iterations: at most this many a stage.
    """

    point_reach: tuple[float, ...] = (40.0, 20.0, 10.0, 5.0)
    reach: tuple[float, ...] = (3.0, 1.5)
    neighbours: int = 20
    iterations: int = 50
    name: ClassVar[str] = "small_gicp"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"small_gicp": version("small_gicp"), "start": "centroids together", **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        step = spacing(open3d_cloud(source), open3d_cloud(target))
        # A grid this fine leaves every point in a cell of its own.
        fixed, fixed_tree = small_gicp.preprocess_points(
            target, downsampling_resolution=1e-3 * step, num_neighbors=self.neighbours
        )
        moving, _ = small_gicp.preprocess_points(
            source, downsampling_resolution=1e-3 * step, num_neighbors=self.neighbours
        )
        T = centroids_together(source, target)
        stages = [("ICP", reach) for reach in self.point_reach]
        stages += [("GICP", reach) for reach in self.reach]
        for kind, reach in stages:
            T = small_gicp.align(
                fixed,
                moving,
                fixed_tree,
                T,
                registration_type=kind,
                max_correspondence_distance=reach * step,
                max_iterations=self.iterations,
                rotation_epsilon=1e-5,
                translation_epsilon=1e-4 * step,
            ).T_target_source
        return Answer(np.array(T))
