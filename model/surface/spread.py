"""How much the surface kernel's gradient varies over samplings of the surfaces."""

from __future__ import annotations

import numpy as np

from model.compiled import compiled
from model.profile import gaussian
from model.surface.arrays import SurfaceArrays
from model.surface.cells import FloatArray
from model.surface.cloud import CellView
from model.surface.near_pairs import NearPairs, longest_run, near_pairs
from model.surface.pair_weight import compare_features, count_pairs, turn_features
from model.surface.rigid import moved, turned


def pull_spread(
    view: CellView,
    source: SurfaceArrays,
    T: FloatArray,
    lengthscale: float,
    across: float,
    cut: float,
    block: float,
) -> FloatArray:
    """Variance (6, 6) of the summed pulls over both samplings, as of a two-sample U-statistic.

    Σ_b s_b s_bᵀ + Σ_b t_b t_bᵀ − Σ_ij p_ij p_ijᵀ over blocks of source and of target points: points
    of a block share the samples that their normals were fitted to, so they don't err independently;
    and a pair belongs to one point of each cloud and would otherwise count twice. The pose was
    fitted to these very pulls, which leaves B − 6 degrees of freedom to B blocks.

    Args:
        view: of the target.
        source: M points.
        T: (4, 4).
        lengthscale: ℓ along the surface.
        across: ℓ_n across it.
        cut: pairs farther apart are left out.
        block: edge of a block.
    """
    listed = near_pairs(view.cells, view.arrays.points, source.points, T, cut)
    by_target, by_source, pairs = _pulls(listed, view.arrays, source, T, lengthscale, across)
    of_target = _block_squares(view.arrays.points, by_target, block)
    of_source = _block_squares(source.points, by_source, block)
    spread = of_source + of_target - pairs
    values, axes = np.linalg.eigh(spread)
    floored: FloatArray = (axes * np.maximum(values, 1e-12 * max(values[-1], 1e-30))) @ axes.T
    return floored


def _block_squares(points: FloatArray, pulls: FloatArray, block: float) -> FloatArray:
    """B/(B−6) Σ s sᵀ over sums s of pulls (N, 6) of the points (N, 3) in each cell of a grid."""
    cell = np.floor(points / block).astype(np.int64)
    cell -= cell.min(axis=0)
    shape = cell.max(axis=0) + 1
    flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(flat, kind="stable")
    starts = np.flatnonzero(np.diff(flat[order], prepend=-1))
    sums = np.add.reduceat(pulls[order], starts, axis=0)
    freedom = max(1, len(sums) - pulls.shape[1])
    squares: FloatArray = len(sums) / freedom * (sums.T @ sums)
    return squares


@compiled
def _pulls(
    near: NearPairs,
    target: SurfaceArrays,
    source: SurfaceArrays,
    T: FloatArray,
    lengthscale: float,
    across: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Each point's share of the gradient, (N, 6) and (M, 6), and Σ p pᵀ over the pairs, (6, 6).

    The turning of normals and features is left out: it is small beside the distances.
    """
    a_iso = 1.0 / (lengthscale * lengthscale)
    a_normal = 1.0 / (across * across) - a_iso
    width = target.features.shape[1]
    by_target, by_source = np.zeros((len(target.points), 6)), np.zeros((len(source.points), 6))
    squares = np.zeros((6, 6))
    g = np.empty(width, np.float32)
    longest = longest_run(near)
    counts, slopes, pulls = np.empty(longest), np.empty(longest), np.empty((6, longest))
    for j in range(len(source.points)):
        first, count = near.start[j], near.start[j + 1] - near.start[j]
        y0, y1, y2 = moved(T, source.points, j)
        m0, m1, m2 = turned(T, source.normals, j)
        count_pairs(near, target, source, j, counts)
        if width:
            turn_features(source.features, j, T, g)
            compare_features(near, target.features, g, j, counts, slopes)
        for a in range(count):
            p = near.target[first + a]
            d0 = target.points[p, 0] - y0
            d1 = target.points[p, 1] - y1
            d2 = target.points[p, 2] - y2
            n0, n1, n2 = target.normals[p, 0], target.normals[p, 1], target.normals[p, 2]
            dot = n0 * m0 + n1 * m1 + n2 * m2
            r = n0 * d0 + n1 * d1 + n2 * d2
            q = m0 * d0 + m1 * d1 + m2 * d2
            both, iso = counts[a] * dot * dot, (d0 * d0 + d1 * d1 + d2 * d2) * a_iso
            w = both * gaussian(iso + r * r * a_normal)
            o = both * gaussian(iso + q * q * a_normal)
            along, plane, own = a_iso * (w + o), a_normal * w * r, a_normal * o * q
            t0 = along * d0 + plane * n0 + own * m0
            t1 = along * d1 + plane * n1 + own * m1
            t2 = along * d2 + plane * n2 + own * m2
            pulls[0, a], pulls[1, a], pulls[2, a] = t0, t1, t2
            pulls[3, a] = y1 * t2 - y2 * t1 + own * (d1 * m2 - d2 * m1)
            pulls[4, a] = y2 * t0 - y0 * t2 + own * (d2 * m0 - d0 * m2)
            pulls[5, a] = y0 * t1 - y1 * t0 + own * (d0 * m1 - d1 * m0)
        for a in range(count):
            for c in range(6):
                by_target[near.target[first + a], c] += pulls[c, a]
        for b in range(6):
            total = 0.0
            for a in range(count):
                total += pulls[b, a]
            by_source[j, b] = total
            for c in range(b, 6):
                total = 0.0
                for a in range(count):
                    total += pulls[b, a] * pulls[c, a]
                squares[b, c] += total
    for b in range(6):
        for c in range(b):
            squares[b, c] = squares[c, b]
    return by_target, by_source, squares
