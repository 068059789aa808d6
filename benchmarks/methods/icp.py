"""Open3D's local methods: ICP and generalized ICP, coarse to fine."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
import open3d as o3d

from benchmarks.methods.method import Answer
from benchmarks.methods.open3d_cloud import NORMAL_RADIUS, neighbourhood, open3d_cloud, spacing
from benchmarks.methods.start import centroids_together
from benchmarks.pair import FloatArray

_registration: Any = o3d.pipelines.registration

# Share of the correspondences that a stage has to keep.
_COLLAPSE = 0.5


@dataclass(frozen=True, slots=True)
class OpenIcp:
    """Point-to-point steps that reach far, then point-to-plane steps that fit closely.

    Attributes:
        point_reach: correspondence distances of the point-to-point stages, in spacings.
        plane_reach: those of the point-to-plane stages.
        iterations: at most this many a stage.
    """

    point_reach: tuple[float, ...] = (40.0, 20.0, 10.0, 5.0)
    plane_reach: tuple[float, ...] = (3.0, 1.5)
    iterations: int = 50
    name: ClassVar[str] = "icp"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"open3d": o3d.__version__, "start": "centroids together", **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        moving, fixed = open3d_cloud(source), open3d_cloud(target)
        step = spacing(moving, fixed)
        fixed.estimate_normals(neighbourhood(NORMAL_RADIUS * step))
        T = centroids_together(source, target)
        point = _registration.TransformationEstimationPointToPoint(with_scaling=False)
        plane = _registration.TransformationEstimationPointToPlane()
        for estimation, reaches in ((point, self.point_reach), (plane, self.plane_reach)):
            for reach in reaches:
                T = closer(moving, fixed, T, reach * step, estimation, self.iterations)
        return Answer(T)


@dataclass(frozen=True, slots=True)
class OpenGicp:
    """Point-to-point steps that reach far, then plane-to-plane steps.

    Plane-to-plane steps alone end in more local minima when they start from a large angle.

    Attributes:
        point_reach: correspondence distances of the point-to-point stages, in spacings.
        reach: those of the plane-to-plane stages.
        iterations: at most this many a stage.
    """

    point_reach: tuple[float, ...] = (40.0, 20.0, 10.0, 5.0)
    reach: tuple[float, ...] = (3.0, 1.5)
    iterations: int = 50
    name: ClassVar[str] = "gicp"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings."""
        return {"open3d": o3d.__version__, "start": "centroids together", **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register; it draws nothing at random."""
        moving, fixed = open3d_cloud(source), open3d_cloud(target)
        step = spacing(moving, fixed)
        for cloud in (moving, fixed):
            cloud.estimate_normals(neighbourhood(NORMAL_RADIUS * step))
        T = centroids_together(source, target)
        point = _registration.TransformationEstimationPointToPoint(with_scaling=False)
        plane = _registration.TransformationEstimationForGeneralizedICP()
        for estimation, reaches in ((point, self.point_reach), (plane, self.reach)):
            for reach in reaches:
                T = closer(moving, fixed, T, reach * step, estimation, self.iterations)
        return Answer(T)


def closer(
    moving: Any, fixed: Any, T: FloatArray, reach: float, estimation: Any, iterations: int
) -> FloatArray:
    """One stage of ICP from T (4, 4), taken back if it loses most of its correspondences.

    With few correspondences a point-to-plane step can be singular and throw the source far away.
    Losing some is no fault: a better pose may have fewer points within a close reach.

    Args:
        moving: the source.
        fixed: the target; it has normals, and for plane-to-plane steps so has the source.
        T: where the stage starts.
        reach: correspondence distance.
        estimation: Open3D's rule of a step.
        iterations: at most.
    """
    generalized = isinstance(estimation, _registration.TransformationEstimationForGeneralizedICP)
    run = (
        _registration.registration_generalized_icp
        if generalized
        else _registration.registration_icp
    )
    criteria = _registration.ICPConvergenceCriteria(max_iteration=iterations)
    before = _registration.evaluate_registration(moving, fixed, reach, T)
    after = run(moving, fixed, reach, T, estimation, criteria)
    collapsed = after.fitness < _COLLAPSE * before.fitness
    return T if collapsed else np.array(after.transformation)


def polished(moving: Any, fixed: Any, T: FloatArray, step: float) -> FloatArray:
    """A global method's pose (4, 4) after point-to-plane ICP; the clouds have their normals."""
    plane = _registration.TransformationEstimationPointToPlane()
    for reach in OpenIcp().plane_reach:
        T = closer(moving, fixed, T, reach * step, plane, OpenIcp().iterations)
    return T
