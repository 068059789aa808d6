"""What speaks for a pose: how the nearest points of the two clouds meet there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.side_by_side import side_by_side
from model.surface.arrays import SurfaceArrays
from model.surface.cells import Cells, FloatArray, IntArray, nearest_to
from model.surface.cloud import SurfaceCloud
from model.surface.rigid import moved, turned
from model.verification.contact import contact, likeness_of

# Neighbours are sought this far, in spacings.
REACH = 2.0
_NEAR, _CLOSE = 1.0, 0.5
# A point lies on the other surface when its neighbour is near, faces alike, and is not above it.
_FACING, _ABOVE = 0.8, 0.3
_PER_SIDE = 9
# Neighbours in the own cloud that tell a patch from strewn points.
_BESIDE = 6
# Log-odds that a pose loses where no neighbour has a label in common.
_LABEL_WEIGHT = 20.0

NAMES = (
    "overlap_least",
    "overlap_mean",
    "surface_least",
    "surface_mean",
    "facing",
    "height",
    "likeness",
    "tightness",
    "gap_patches",
    "misfit_patches",
    "support_share",
    "log_support",
    "log_points",
)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Of K poses, one row each.

    Attributes:
        values: (K, E), in the order of ``NAMES``; none has a unit.
        label_odds: (K,) what the labels of neighbours that differ take from the log-odds; 0 without
            labels, which the verifier doesn't know.
        contacts: (K, 2, POINTS, F) how points of both clouds meet, see ``contact``; None where
            nobody looked so closely.
    """

    values: FloatArray
    label_odds: FloatArray
    contacts: npt.NDArray[np.float32] | None = None

    def select(self, rows: npt.NDArray[np.int64]) -> Evidence:
        """Some of the poses."""
        seen = None if self.contacts is None else self.contacts[rows]
        return Evidence(self.values[rows], self.label_odds[rows], seen)

    def joined(self, other: Evidence) -> Evidence:
        """Of both poses' sets, one after the other; both, or neither, looked at closely."""
        seen = None
        if self.contacts is not None and other.contacts is not None:
            seen = np.concatenate([self.contacts, other.contacts])
        return Evidence(
            np.concatenate([self.values, other.values]),
            np.concatenate([self.label_odds, other.label_odds]),
            seen,
        )

    @classmethod
    def of(
        cls,
        target: SurfaceCloud,
        source: SurfaceCloud,
        T: FloatArray,
        support: FloatArray,
        matches: int,
        closely: bool,
    ) -> Evidence:
        """Look at the neighbours of every point, from both sides.

        Args:
            target: N points.
            source: M points.
            T: (K, 4, 4) T_target_source.
            support: (K,) matches that agree with each.
            matches: how many there are.
            closely: whether to look at how every point meets the other cloud, too.
        """
        spacing = max(target.spacing, source.spacing)
        reach = REACH * spacing
        fixed, moving = target.at(reach), source.at(reach)
        beside_fixed, beside_moving = (
            cloud.remembered(("beside", reach), partial(cloud.neighbours, reach, _BESIDE))
            for cloud in (target, source)
        )
        inverse = np.linalg.inv(T)

        def looked_at(k: int) -> FloatArray:
            a = _one_side(fixed.cells, fixed.arrays, moving.arrays, beside_moving, T[k], spacing)
            b = _one_side(
                moving.cells, moving.arrays, fixed.arrays, beside_fixed, inverse[k], spacing
            )
            return _of_both_sides(a, b)

        sides = np.stack(side_by_side(looked_at, range(len(T))))
        label_odds = _LABEL_WEIGHT * (sides[:, -1] - 1.0)
        of_matches = np.stack([support / max(matches, 1), np.log1p(support)], axis=1)
        fewer = math.log(min(len(fixed.arrays.points), len(moving.arrays.points)))
        rows = np.column_stack([sides[:, :-1], of_matches, np.full(len(T), fewer)])
        seen = None
        if closely:
            seen = np.stack(side_by_side(lambda pose: contact(target, source, pose), T))
        return cls(rows, label_odds, seen)


def _of_both_sides(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of both sides' shares and means the least and the mean, or the mean alone, (11,)."""
    least, both = np.minimum(a, b), 0.5 * (a + b)
    return np.concatenate([[least[0], both[0], least[1]], both[1:]])


@compiled
def _one_side(
    cells: Cells,
    fixed: SurfaceArrays,
    moving: SurfaceArrays,
    neighbours: IntArray,
    T: FloatArray,
    spacing: float,
) -> FloatArray:
    """Shares and means over the moving points' nearest fixed points, (9,).

    In order: share near; share on the surface; mean |n·m|, height and likeness of features, over
    those near; share close among those near; share of points off it among the neighbours of points
    that aren't near, and of those that aren't on the surface. What a crop took away lies together;
    what a wrong pose leaves uncovered is strewn about. Last, the cosine of the labels of those
    near; 1 without labels.
    """
    is_near = np.zeros(len(moving.points), np.bool_)
    is_on = np.zeros(len(moving.points), np.bool_)
    reach2 = (REACH * spacing) ** 2
    width, traits = fixed.features.shape[1], fixed.labels.shape[1]
    channels = width // 3
    runs = np.empty((9, 2), np.int64)
    near = on = close = 0
    facing = height = likeness = alike = 0.0
    for j in range(len(moving.points)):
        y0, y1, y2 = moved(T, moving.points, j)
        at, nearest = nearest_to(cells, y0, y1, y2, reach2, runs)
        if at < 0 or nearest > (_NEAR * spacing) ** 2:
            continue
        near += 1
        is_near[j] = True
        if nearest < (_CLOSE * spacing) ** 2:
            close += 1
        m0, m1, m2 = turned(T, moving.normals, j)
        x0, x1, x2 = fixed.normals[at, 0], fixed.normals[at, 1], fixed.normals[at, 2]
        d0, d1, d2 = fixed.points[at, 0] - y0, fixed.points[at, 1] - y1, fixed.points[at, 2] - y2
        dot = abs(x0 * m0 + x1 * m1 + x2 * m2)
        above = (
            0.5 * (abs(x0 * d0 + x1 * d1 + x2 * d2) + abs(m0 * d0 + m1 * d1 + m2 * d2)) / spacing
        )
        facing += dot
        height += above
        if dot > _FACING and above < _ABOVE:
            on += 1
            is_on[j] = True
        if width:
            likeness += likeness_of(fixed.features, at, moving.features, j, T, 0, channels)
        if traits:
            both = own_labels = other_labels = 0.0
            for c in range(traits):
                both += fixed.labels[at, c] * moving.labels[j, c]
                own_labels += moving.labels[j, c] ** 2
                other_labels += fixed.labels[at, c] ** 2
            alike += both / math.sqrt(own_labels * other_labels + 1e-12)
    out = np.zeros(_PER_SIDE)
    out[8] = alike / near if traits and near > 0 else 1.0
    if near > 0:
        total = len(moving.points)
        out[0] = near / total
        out[1] = on / total
        out[2] = facing / near
        out[3] = height / near
        out[4] = likeness / near
        out[5] = close / near
    out[6] = patches(is_near, neighbours)
    out[7] = patches(is_on, neighbours)
    return out


@compiled
def patches(flag: npt.NDArray[np.bool_], neighbours: IntArray) -> float:
    """Share of points without the flag among the neighbours of points without it; 1 if all have."""
    without = alike = 0
    for j in range(len(flag)):
        if flag[j]:
            continue
        for a in range(neighbours.shape[1]):
            without += 1
            if not flag[neighbours[j, a]]:
                alike += 1
    return alike / without if without else 1.0
