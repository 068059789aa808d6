"""Inner products of the surface kernel without their derivatives."""

from __future__ import annotations

import numpy as np
import torch

from model.compiled import compiled
from model.kernel import InnerProducts
from model.profile import gaussian
from model.side_by_side import run_together
from model.surface.arrays import SurfaceArrays
from model.surface.cells import FloatArray
from model.surface.cloud import SurfaceCloud
from model.surface.moments import REACH, VIEW
from model.surface.near_pairs import NearPairs, longest_run, near_pairs, own_pairs
from model.surface.pair_weight import compare_features, count_pairs, turn_features
from model.surface.rigid import moved, turned


def surface_products(
    target: SurfaceCloud, source: SurfaceCloud, T: FloatArray, ell: float, across: float
) -> InnerProducts:
    """⟨X,X⟩, ⟨Z,Z⟩ and ⟨X,hZ⟩ on the surface kernel, a batch of one."""
    cross = surface_product(target, source, T, ell, across)
    values = (*surface_norms(target, source, ell, across), cross)
    xx, zz, xz = (torch.tensor([value], dtype=torch.float64) for value in values)
    return InnerProducts(xx, zz, xz)


def surface_norms(
    target: SurfaceCloud, source: SurfaceCloud, ell: float, across: float
) -> tuple[float, float]:
    """⟨X,X⟩ and ⟨Z,Z⟩."""
    return run_together(
        lambda: surface_norm(target, ell, across), lambda: surface_norm(source, ell, across)
    )


def surface_norm(cloud: SurfaceCloud, ell: float, across: float) -> float:
    """⟨X,X⟩, taken once for each ℓ."""

    def norm() -> float:
        cut, still = REACH * ell, np.eye(4)
        cells, arrays = cloud.at(VIEW * ell)
        rows = np.arange(len(arrays.points) + 1)
        alone = NearPairs(rows, rows[:-1].astype(np.int32))
        pairs = own_pairs(cells, cut)
        both = surface_sum(pairs, arrays, arrays, still, ell, across, cut)
        return surface_sum(alone, arrays, arrays, still, ell, across, cut) + 2.0 * both

    return cloud.remembered(("norm", ell, across), norm)


def surface_product(
    target: SurfaceCloud, source: SurfaceCloud, T: FloatArray, ell: float, across: float
) -> float:
    """⟨X,hZ⟩ alone."""
    cut = REACH * ell
    view = target.at(VIEW * ell)
    pairs = near_pairs(view.cells, view.arrays.points, source.arrays.points, T, cut)
    return surface_sum(pairs, view.arrays, source.arrays, T, ell, across, cut)


@compiled
def surface_sum(
    pairs: NearPairs,
    target: SurfaceArrays,
    source: SurfaceArrays,
    T: FloatArray,
    lengthscale: float,
    across: float,
    cut: float,
) -> float:
    """S = Σ_ij k_ij; the arguments are those of ``surface_moments``."""
    a_iso = 1.0 / (lengthscale * lengthscale)
    a_normal = 1.0 / (across * across) - a_iso
    cut2 = cut * cut
    width = target.features.shape[1]
    g = np.empty(width, np.float32)
    longest = longest_run(pairs)
    counts, slopes = np.empty(longest), np.empty(longest)
    value = 0.0
    for j in range(len(source.points)):
        first, near = pairs.start[j], pairs.start[j + 1] - pairs.start[j]
        y0, y1, y2 = moved(T, source.points, j)
        m0, m1, m2 = turned(T, source.normals, j)
        count_pairs(pairs, target, source, j, counts)
        if width:
            turn_features(source.features, j, T, g)
            compare_features(pairs, target.features, g, j, counts, slopes)
        mass = 0.0
        for a in range(near):
            p = pairs.target[first + a]
            d0 = target.points[p, 0] - y0
            d1 = target.points[p, 1] - y1
            d2 = target.points[p, 2] - y2
            x0, x1, x2 = target.normals[p, 0], target.normals[p, 1], target.normals[p, 2]
            distance2 = d0 * d0 + d1 * d1 + d2 * d2
            dot = x0 * m0 + x1 * m1 + x2 * m2
            r = x0 * d0 + x1 * d1 + x2 * d2
            q = m0 * d0 + m1 * d1 + m2 * d2
            iso = distance2 * a_iso
            both = counts[a] if distance2 <= cut2 else 0.0
            seen = gaussian(iso + r * r * a_normal) + gaussian(iso + q * q * a_normal)
            mass += both * dot * dot * seen
        value += mass
    return value
