"""Open3D's global methods on FPFH features: RANSAC and fast global registration, then ICP.

Neither estimates a scale. Every length is a multiple of the clouds' spacing.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
import open3d as o3d

from benchmarks.methods.icp import polished
from benchmarks.methods.method import Answer
from benchmarks.methods.open3d_cloud import (
    estimate_outward_normals,
    neighbourhood,
    open3d_cloud,
    spacing,
)
from benchmarks.pair import FloatArray

_registration: Any = o3d.pipelines.registration


@dataclass(frozen=True, slots=True)
class Features:
    """How FPFH is computed.

    Attributes:
        normal_radius: in spacings.
        feature_radius: in spacings.
        neighbours: at most this many in a feature's neighbourhood.
    """

    normal_radius: float = 7.0
    feature_radius: float = 9.0
    neighbours: int = 100

    def of(self, points: FloatArray, step: float) -> tuple[Any, Any]:
        """The cloud (N, 3) with its normals, and its features."""
        cloud = open3d_cloud(points)
        estimate_outward_normals(cloud, self.normal_radius * step)
        search = neighbourhood(self.feature_radius * step, self.neighbours)
        return cloud, _registration.compute_fpfh_feature(cloud, search)


@dataclass(frozen=True, slots=True)
class FpfhRansac:
    """RANSAC over mutually nearest features, three a sample, then ICP.

    A wrong pose that flips a shape often has as many inliers at RANSAC's wide reach as the right
    one; several runs, judged after ICP by a close reach, mend some of that and take longer.
    Open3D draws in several threads, so that even a seed leaves the last of it to chance.

    Attributes:
        features: how they are computed.
        reach: distance that counts as an inlier, in spacings.
        edge_ratio: least ratio of a sample's corresponding edges.
        iterations: at most.
        confidence: of having drawn one good sample, which ends the search.
        runs: the best of so many, by the share of points within ``closeness`` after ICP.
        closeness: in spacings.
    """

    features: Features = Features()
    reach: float = 2.0
    edge_ratio: float = 0.9
    iterations: int = 100_000
    confidence: float = 0.999
    runs: int = 1
    closeness: float = 1.5

    @property
    def name(self) -> str:
        """See Method.name."""
        return "ransac" if self.runs == 1 else f"ransac_{self.runs}"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"open3d": o3d.__version__, "with_scaling": False, **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register."""
        step = spacing(open3d_cloud(source), open3d_cloud(target))
        moving, moving_features = self.features.of(source, step)
        fixed, fixed_features = self.features.of(target, step)
        o3d.utility.random.seed(seed)
        best, most = np.eye(4), -1.0
        for _ in range(self.runs):
            T = self._run(moving, fixed, moving_features, fixed_features, step)
            T = polished(moving, fixed, T, step)
            reach = self.closeness * step
            fitness = float(_registration.evaluate_registration(moving, fixed, reach, T).fitness)
            if fitness > most:
                best, most = T, fitness
        return Answer(best, {"fitness": most})

    def _run(
        self, moving: Any, fixed: Any, moving_features: Any, fixed_features: Any, step: float
    ) -> FloatArray:
        # Open3D warns when few features match mutually, and then uses all of them.
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            found = _registration.registration_ransac_based_on_feature_matching(
                moving,
                fixed,
                moving_features,
                fixed_features,
                mutual_filter=True,
                max_correspondence_distance=self.reach * step,
                estimation_method=_registration.TransformationEstimationPointToPoint(
                    with_scaling=False
                ),
                ransac_n=3,
                checkers=[
                    _registration.CorrespondenceCheckerBasedOnEdgeLength(self.edge_ratio),
                    _registration.CorrespondenceCheckerBasedOnDistance(self.reach * step),
                ],
                criteria=_registration.RANSACConvergenceCriteria(self.iterations, self.confidence),
            )
        return np.array(found.transformation)


def ransac_of_three() -> FpfhRansac:
    """The best of three runs."""
    return FpfhRansac(runs=3)


@dataclass(frozen=True, slots=True)
class FpfhFgr:
    """Fast global registration at absolute scale, then ICP.

    Attributes:
        features: how they are computed.
        reach: correspondence distance, in spacings.
        iterations: of its graduated optimisation.
        tuples: at most this many triples of matches.
        tuple_scale: least ratio of a triple's corresponding edges; Open3D's 0.95 refuses right
            triples where noise is a fifth of the spacing.
    """

    features: Features = Features()
    reach: float = 2.5
    iterations: int = 64
    tuples: int = 1000
    tuple_scale: float = 0.9
    name: ClassVar[str] = "fgr"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"open3d": o3d.__version__, "use_absolute_scale": True, **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register."""
        step = spacing(open3d_cloud(source), open3d_cloud(target))
        moving, moving_features = self.features.of(source, step)
        fixed, fixed_features = self.features.of(target, step)
        o3d.utility.random.seed(seed)
        option = _registration.FastGlobalRegistrationOption(
            use_absolute_scale=True,
            decrease_mu=True,
            maximum_correspondence_distance=self.reach * step,
            iteration_number=self.iterations,
            maximum_tuple_count=self.tuples,
            tuple_scale=self.tuple_scale,
        )
        found = _registration.registration_fgr_based_on_feature_matching(
            moving, fixed, moving_features, fixed_features, option
        )
        T = polished(moving, fixed, np.array(found.transformation), step)
        return Answer(T, {"fitness": float(found.fitness)})
