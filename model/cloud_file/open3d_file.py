"""What is left to Open3D: writing PLY and PCD, and unpacking compressed PCD.

Reading is done through NumPy. Open3D 0.20 answers a truncated file, a header that promises too
many points or a word among the numbers with uninitialised memory instead of an error, and skips
most of its warnings.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def silent_open3d() -> Any:
    """A context in which Open3D prints errors only."""
    import open3d

    return open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error)


def write_with_open3d(path: Path, points: FloatArray) -> None:
    """Write points (N, 3) to a PLY or PCD file.

    Raises:
        OSError: Open3D doesn't say why.
    """
    import open3d

    with silent_open3d():
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        if not open3d.io.write_point_cloud(path, cloud):
            raise OSError(f"Open3D could not write {path.name}")
