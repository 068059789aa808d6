"""How far a trajectory is from the measured one: ATE over the whole, RPE over gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.odometry.consistency import angle_deg

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spread:
    """Of errors.

    Attributes:
        mean: of them.
        std: around the mean.
        median: of them.
        rmse: root mean square.
        largest: of them.
    """

    mean: float
    std: float
    median: float
    rmse: float
    largest: float

    @classmethod
    def of(cls, errors: FloatArray) -> Spread:
        """Of errors (n,), n ≥ 1."""
        return cls(
            float(errors.mean()),
            float(errors.std()),
            float(np.median(errors)),
            float(np.sqrt(np.mean(errors**2))),
            float(errors.max()),
        )


@dataclass(frozen=True, slots=True)
class AbsoluteError:
    """Distances between the positions after the best rigid alignment (ATE).

    Attributes:
        T_truth_world: (4, 4), the alignment.
        distances: (n,) by frame.
        spread: of them.
    """

    T_truth_world: FloatArray
    distances: FloatArray
    spread: Spread

    @classmethod
    def of(cls, T_found: FloatArray, T_true: FloatArray) -> AbsoluteError | None:
        """Compare T_world_camera (n, 4, 4); None for fewer than 2 frames."""
        if len(T_found) < 2:
            return None
        T = aligned(T_found[:, :3, 3], T_true[:, :3, 3])
        moved = T_found[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
        distances: FloatArray = np.linalg.norm(moved - T_true[:, :3, 3], axis=1)
        return cls(T, distances, Spread.of(distances))


@dataclass(frozen=True, slots=True)
class RelativeError:
    """Errors of the motions between frames that are a gap apart (RPE).

    Attributes:
        gap: in steps of the trajectory.
        rotations_deg: (n,).
        translations: (n,).
        rotation_deg: their spread.
        translation: their spread.
    """

    gap: int
    rotations_deg: FloatArray
    translations: FloatArray
    rotation_deg: Spread
    translation: Spread

    @classmethod
    def of(cls, T_found: FloatArray, T_true: FloatArray, gap: int) -> RelativeError | None:
        """Compare T_world_camera (n, 4, 4); None where no two frames are that far apart."""
        if gap < 1 or len(T_found) <= gap:
            return None
        found = np.linalg.inv(T_found[:-gap]) @ T_found[gap:]
        true = np.linalg.inv(T_true[:-gap]) @ T_true[gap:]
        left = np.linalg.inv(true) @ found
        angles = np.array([angle_deg(T) for T in left])
        shifts: FloatArray = np.linalg.norm(left[:, :3, 3], axis=1)
        return cls(gap, angles, shifts, Spread.of(angles), Spread.of(shifts))


def aligned(points: FloatArray, onto: FloatArray) -> FloatArray:
    """The rigid motion (4, 4) that brings points (n, 3) closest to their partners (n, 3)."""
    centre, centre_onto = points.mean(axis=0), onto.mean(axis=0)
    U, _, Vh = np.linalg.svd((onto - centre_onto).T @ (points - centre))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vh)]) @ Vh
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, centre_onto - R @ centre
    return T
