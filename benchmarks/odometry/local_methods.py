"""Registration from a predicted pose, as odometry needs it: one method, one class."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, ClassVar, Protocol

import numpy as np
import open3d as o3d

from benchmarks.methods.fpfh import FpfhRansac
from benchmarks.methods.icp import closer
from benchmarks.methods.open3d_cloud import NORMAL_RADIUS, neighbourhood, open3d_cloud, spacing
from benchmarks.methods.single_start import SingleStart
from benchmarks.pair import FloatArray

_registration: Any = o3d.pipelines.registration

# Correspondence distances, in spacings: from what a prediction may be off to a close fit.
REACHES = (6.0, 3.0, 1.5)
_ITERATIONS = 50


class LocalMethod(Protocol):
    """Registers two clouds from a guess."""

    @property
    def name(self) -> str:
        """In options, files and tables."""
        ...

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers, as plain values."""
        ...

    def register(self, source: FloatArray, target: FloatArray, T_guess: FloatArray) -> FloatArray:
        """T_target_source (4, 4) from a guess of it."""
        ...


@dataclass(frozen=True, slots=True)
class LocalIcp:
    """Open3D's ICP, point-to-plane or plane-to-plane, closer and closer.

    Attributes:
        generalized: plane-to-plane.
        reaches: correspondence distances of its stages, in spacings.
        iterations: at most this many a stage.
    """

    generalized: bool = False
    reaches: tuple[float, ...] = REACHES
    iterations: int = _ITERATIONS

    @property
    def name(self) -> str:
        """See LocalMethod."""
        return "gicp" if self.generalized else "icp"

    @property
    def settings(self) -> dict[str, Any]:
        """See LocalMethod."""
        return {"open3d": o3d.__version__, "start": "predicted pose", **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, T_guess: FloatArray) -> FloatArray:
        """See LocalMethod."""
        moving, fixed = open3d_cloud(source), open3d_cloud(target)
        step = spacing(moving, fixed)
        for cloud in (moving, fixed):
            cloud.estimate_normals(neighbourhood(NORMAL_RADIUS * step))
        rule = (
            _registration.TransformationEstimationForGeneralizedICP()
            if self.generalized
            else _registration.TransformationEstimationPointToPlane()
        )
        T = T_guess
        for reach in self.reaches:
            T = closer(moving, fixed, T, reach * step, rule, self.iterations)
        return T


@dataclass(frozen=True, slots=True)
class LocalSmallGicp:
    """GICP as the small_gicp package does it; it is optional.

    Attributes:
        reaches: correspondence distances of its stages, in spacings.
        neighbours: of a point's covariance.
        iterations: at most this many a stage.
    """

    reaches: tuple[float, ...] = REACHES
    neighbours: int = 20
    iterations: int = _ITERATIONS
    name: ClassVar[str] = "small_gicp"

    @property
    def settings(self) -> dict[str, Any]:
        """See LocalMethod."""
        return {"small_gicp": version("small_gicp"), "start": "predicted pose", **asdict(self)}

    def register(self, source: FloatArray, target: FloatArray, T_guess: FloatArray) -> FloatArray:
        """See LocalMethod."""
        import small_gicp

        step = spacing(open3d_cloud(source), open3d_cloud(target))
        # A grid this fine leaves every point in a cell of its own.
        (fixed, tree), (moving, _) = (
            small_gicp.preprocess_points(
                points, downsampling_resolution=1e-3 * step, num_neighbors=self.neighbours
            )
            for points in (target, source)
        )
        T = T_guess
        for reach in self.reaches:
            T = small_gicp.align(
                fixed,
                moving,
                tree,
                T,
                registration_type="GICP",
                max_correspondence_distance=reach * step,
                max_iterations=self.iterations,
                rotation_epsilon=1e-5,
                translation_epsilon=1e-4 * step,
            ).T_target_source
        return np.array(T)


@dataclass(frozen=True, slots=True)
class RansacIcp:
    """FPFH, RANSAC and ICP, which need no guess.

    Attributes:
        ransac: see FpfhRansac.
        seed: of its draws.
    """

    ransac: FpfhRansac
    seed: int
    name: ClassVar[str] = "ransac"

    @property
    def settings(self) -> dict[str, Any]:
        """See LocalMethod."""
        return {"start": "none", **self.ransac.settings}

    def register(self, source: FloatArray, target: FloatArray, T_guess: FloatArray) -> FloatArray:
        """See LocalMethod."""
        return self.ransac.register(source, target, self.seed).T_target_source


@dataclass(frozen=True, slots=True)
class LocalCvo:
    """Geometric-CVO: the paper's gradient flow on the kernel without features.

    Attributes:
        single: see SingleStart.
    """

    single: SingleStart
    name: ClassVar[str] = "geometric_cvo"

    @property
    def settings(self) -> dict[str, Any]:
        """See LocalMethod."""
        return {**self.single.settings, "start": "predicted pose"}

    def register(self, source: FloatArray, target: FloatArray, T_guess: FloatArray) -> FloatArray:
        """See LocalMethod."""
        return self.single.register_from(source, target, T_guess).T_target_source
