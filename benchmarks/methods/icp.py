"""Open3D's local methods: ICP and generalized ICP, coarse to fine."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
import open3d as o3d

from benchmarks.methods.method import Answer
from benchmarks.methods.open3d_cloud import NORMAL_RADIUS, neighbourhood, open3d_cloud, spacing
from benchmarks.methods.start import Start, start_pose
from benchmarks.pair import FloatArray

_registration: Any = o3d.pipelines.registration


@dataclass(frozen=True, slots=True)
class OpenIcp:
    """Point-to-point steps that reach far, then point-to-plane steps that fit closely.

    Attributes:
        start: where it starts from.
        point_reach: correspondence distances of the point-to-point stages, in spacings.
        plane_reach: those of the point-to-plane stages.
        iterations: at most this many a stage.
    """

    start: Start = "centroids"
    point_reach: tuple[float, ...] = (40.0, 20.0, 10.0)
    plane_reach: tuple[float, ...] = (3.0, 1.5)
    iterations: int = 50
    name: ClassVar[str] = "icp"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"open3d": o3d.__version__, **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        moving, fixed = open3d_cloud(source), open3d_cloud(target)
        step = spacing(moving, fixed)
        fixed.estimate_normals(neighbourhood(NORMAL_RADIUS * step))
        T = start_pose(self.start, source, target)
        point = _registration.TransformationEstimationPointToPoint(with_scaling=False)
        plane = _registration.TransformationEstimationPointToPlane()
        for estimation, reaches in ((point, self.point_reach), (plane, self.plane_reach)):
            for reach in reaches:
                T = _registration.registration_icp(
                    moving, fixed, reach * step, T, estimation, convergence(self.iterations)
                ).transformation
        return Answer(np.array(T))


@dataclass(frozen=True, slots=True)
class OpenGicp:
    """Plane-to-plane.

    Attributes:
        start: where it starts from.
        reach: correspondence distances of the stages, in spacings.
        iterations: at most this many a stage.
    """

    start: Start = "centroids"
    reach: tuple[float, ...] = (20.0, 10.0, 3.0, 1.5)
    iterations: int = 50
    name: ClassVar[str] = "gicp"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"open3d": o3d.__version__, **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        moving, fixed = open3d_cloud(source), open3d_cloud(target)
        step = spacing(moving, fixed)
        for cloud in (moving, fixed):
            cloud.estimate_normals(neighbourhood(NORMAL_RADIUS * step))
        T = start_pose(self.start, source, target)
        estimation = _registration.TransformationEstimationForGeneralizedICP()
        for reach in self.reach:
            T = _registration.registration_generalized_icp(
                moving, fixed, reach * step, T, estimation, convergence(self.iterations)
            ).transformation
        return Answer(np.array(T))


def convergence(iterations: int) -> Any:
    """Stop at Open3D's usual relative changes of 1e-6, or after this many iterations."""
    return _registration.ICPConvergenceCriteria(max_iteration=iterations)


def polished(moving: Any, fixed: Any, T: FloatArray, step: float) -> FloatArray:
    """A global method's pose (4, 4) after point-to-plane ICP; the clouds have their normals."""
    plane = _registration.TransformationEstimationPointToPlane()
    for reach in OpenIcp().plane_reach:
        T = _registration.registration_icp(
            moving, fixed, reach * step, T, plane, convergence(OpenIcp().iterations)
        ).transformation
    return np.array(T)
