"""Clouds as Open3D's baselines want them, with radii tied to the points' spacing."""

from __future__ import annotations

from typing import Any

import numpy as np
import open3d as o3d

from benchmarks.pair import FloatArray

NORMAL_RADIUS = 4.0
_NORMAL_NEIGHBOURS = 30


def open3d_cloud(points: FloatArray) -> Any:
    """A point cloud of (N, 3)."""
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def spacing(*clouds: Any) -> float:
    """Median distance to the nearest neighbour, of the sparser cloud."""
    return max(float(np.median(cloud.compute_nearest_neighbor_distance())) for cloud in clouds)


def neighbourhood(radius: float, neighbours: int = _NORMAL_NEIGHBOURS) -> Any:
    """The search that normals and features are estimated with."""
    return o3d.geometry.KDTreeSearchParamHybrid(radius, neighbours)


def estimate_outward_normals(cloud: Any, radius: float) -> None:
    """Normals pointing away from the centroid.

    A histogram of angles between normals depends on their signs, which an eigenvector leaves open.
    This rule turns with the cloud, and it makes FPFH far stronger than Open3D's arbitrary signs.
    """
    cloud.estimate_normals(neighbourhood(radius))
    cloud.orient_normals_towards_camera_location(cloud.get_center())
    cloud.normals = o3d.utility.Vector3dVector(-np.asarray(cloud.normals))
