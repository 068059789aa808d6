"""How far a found pose is from the true one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree

from benchmarks.pair import BenchmarkPair, FloatArray
from model.se3 import inverse, pose_log, rotation_angle

ADDS_SUCCESS = 0.03


@dataclass(frozen=True, slots=True)
class PoseError:
    """Angles in degrees, lengths in the unit of the clouds.

    Attributes:
        rotation_deg: geodesic angle, the norm of the rotation's matrix logarithm.
        se3_log: norm of the logarithm of T̂ T⁻¹, with radians.
        translation: ‖t̂ − t‖, by which the source frame's origin is off.
        translation_centroid: by which the source's centroid is off.
        adds: mean distance from the dense surface at the true pose to the surface at the found
            pose, nearest points; None where no surface is known.
    """

    rotation_deg: float
    se3_log: float
    translation: float
    translation_centroid: float
    adds: float | None

    @classmethod
    def of(cls, T_found: FloatArray, pair: BenchmarkPair) -> PoseError:
        """Judge T_found (4, 4)."""
        T_true = pair.T_target_source
        found, true = torch.from_numpy(T_found), torch.from_numpy(T_true)
        off = found @ inverse(true)
        centroid = pair.source.mean(axis=0)
        return cls(
            rotation_deg=math.degrees(float(rotation_angle(found[:3, :3], true[:3, :3]))),
            se3_log=float(pose_log(off[None]).norm()),
            translation=float(np.linalg.norm(T_found[:3, 3] - T_true[:3, 3])),
            translation_centroid=float(
                np.linalg.norm(_moved(centroid, T_found) - _moved(centroid, T_true))
            ),
            adds=None if pair.surface is None else adds(pair.surface, off.numpy()),
        )

    @property
    def rank(self) -> tuple[bool, float]:
        """Smaller is better: a success by ADD-S before any failure, then the SE(3) logarithm."""
        return self.adds is not None and self.adds >= ADDS_SUCCESS, self.se3_log


def adds(surface: FloatArray, T_off: FloatArray) -> float:
    """ADD-S of a surface (P, 3) whose found pose is T_off (4, 4) away from the true one."""
    distance, _ = KDTree(_moved(surface, T_off)).query(surface)
    return float(np.mean(distance))


def _moved(points: FloatArray, T: FloatArray) -> FloatArray:
    moved: FloatArray = points @ T[:3, :3].T + T[:3, 3]
    return moved


def initial_angle_deg(T_true: FloatArray) -> float:
    """By how much the source was turned away."""
    true = torch.from_numpy(T_true)[:3, :3]
    return math.degrees(float(rotation_angle(torch.eye(3, dtype=true.dtype), true)))
