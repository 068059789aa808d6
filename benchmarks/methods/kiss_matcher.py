"""KISS-Matcher, as its package does it, then ICP; it is optional."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, ClassVar

import kiss_matcher
import numpy as np

from benchmarks.methods.icp import polished
from benchmarks.methods.method import Answer
from benchmarks.methods.open3d_cloud import NORMAL_RADIUS, neighbourhood, open3d_cloud, spacing
from benchmarks.pair import FloatArray


@dataclass(frozen=True, slots=True)
class KissMatcher:
    """All points, no voxel grid before it: the clouds are small.

    Attributes:
        resolution: its voxel size, which its radii and noise bounds hang on, in spacings.
        normal_radius: in resolutions.
        feature_radius: in resolutions.
        robin_noise_bound: in resolutions.
        solver_noise_bound: in resolutions.
        correspondences: at most.
    """

    resolution: float = 2.0
    normal_radius: float = 4.0
    feature_radius: float = 5.0
    robin_noise_bound: float = 2.0
    solver_noise_bound: float = 1.5
    correspondences: int = 5000
    name: ClassVar[str] = "kiss_matcher"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"kiss_matcher": version("kiss-matcher"), **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        moving, fixed = open3d_cloud(source), open3d_cloud(target)
        step = spacing(moving, fixed)
        matcher = kiss_matcher.KISSMatcher(
            kiss_matcher.KISSMatcherConfig(
                voxel_size=self.resolution,
                use_voxel_sampling=False,
                num_max_corr=self.correspondences,
                normal_r_gain=self.normal_radius,
                fpfh_r_gain=self.feature_radius,
                robin_noise_bound_gain=self.robin_noise_bound,
                solver_noise_bound_gain=self.solver_noise_bound,
                # It would clamp bounds at 1 of its unit, which is one spacing here.
                enable_noise_bound_clamping=False,
            )
        )
        # It refuses resolutions below 0.005: one spacing is its unit of length.
        found = matcher.estimate(
            (source / step).astype(np.float32), (target / step).astype(np.float32)
        )
        if not found.valid:
            return Answer(np.eye(4), {"found": False})
        T = np.eye(4)
        T[:3, :3] = found.rotation
        T[:3, 3] = step * np.ravel(found.translation)
        for cloud in (moving, fixed):
            cloud.estimate_normals(neighbourhood(NORMAL_RADIUS * step))
        return Answer(polished(moving, fixed, T, step), {"found": True})
