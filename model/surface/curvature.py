"""Second derivatives of the surface kernel's sum on SE(3), and what the pose is worth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from model.compiled import compiled
from model.side_by_side import side_by_side
from model.surface.arrays import SurfaceArrays
from model.surface.cells import FloatArray
from model.surface.cloud import CellView
from model.surface.descent import retracted
from model.surface.moments import surface_moments
from model.surface.near_pairs import NearPairs, near_pairs

# The gradient is exact, so its differences are good to about this, relative to the curvature.
_STEP = 1e-6
_TRIES = 5
_WIDER = 1.01


@dataclass(frozen=True, slots=True)
class SurfaceCurvature:
    """S(Exp(δ) T) to second order in δ = (ρ, φ).

    Attributes:
        value: S.
        gradient: (6,).
        hessian: (6, 6); negative definite at a maximum.
    """

    value: float
    gradient: FloatArray
    hessian: FloatArray

    @classmethod
    def of(
        cls,
        pairs: NearPairs,
        target: SurfaceArrays,
        source: SurfaceArrays,
        T: FloatArray,
        lengthscale: float,
        across: float,
        cut: float,
    ) -> SurfaceCurvature:
        """Differentiate at one pose; the arguments are those of ``surface_moments``.

        With all pairs nearer than ``cut`` and no others, none comes or goes meanwhile.
        """
        cut = _WIDER * cut
        here = surface_moments(pairs, target, source, T, lengthscale, across, cut)

        def changed_along(delta: FloatArray) -> FloatArray:
            T_ahead = retracted(T, delta)
            ahead = surface_moments(pairs, target, source, T_ahead, lengthscale, across, cut)
            return (ahead.gradient - here.gradient) / _STEP

        H = np.stack(side_by_side(changed_along, _STEP * np.eye(6)), axis=1)
        return cls(here.value, here.gradient, 0.5 * (H + H.T))


def newton_polish(
    view: CellView,
    source: SurfaceArrays,
    T: FloatArray,
    lengthscale: float,
    across: float,
    cut: float,
    steps: int = 2,
    tolerance: float = 1e-9,
) -> tuple[FloatArray, SurfaceCurvature, bool]:
    """Damped Newton steps to the maximum of S; no step that lowers it is taken.

    Args:
        view: of the target, in cells of at least a cut.
        source: M points.
        T: (4, 4) near the maximum.
        lengthscale: ℓ along the surface.
        across: ℓ_n across it.
        cut: pairs farther apart are left out.
        steps: at most this many.
        tolerance: a step with ‖δ‖ below this isn't taken.

    Returns:
        the pose (4, 4), the curvature before the last step, and whether it was below 1e-4.
    """
    target = view.arrays
    pairs = near_pairs(view.cells, target.points, source.points, T, cut)
    curvature = SurfaceCurvature.of(pairs, target, source, T, lengthscale, across, cut)
    small = False
    for step in range(steps):
        values, axes = np.linalg.eigh(-curvature.hessian)
        # Directions along which the sum isn't concave get a short gradient step.
        stiffness = np.maximum(np.abs(values), 1e-6 * np.abs(values).max() + 1e-30)
        delta = axes @ ((axes.T @ curvature.gradient) / stiffness)
        small = bool(np.linalg.norm(delta) < 1e-4)
        if np.linalg.norm(delta) <= tolerance:
            break
        for _ in range(_TRIES):
            T_try = retracted(T, delta)
            there = surface_moments(pairs, target, source, T_try, lengthscale, across, _WIDER * cut)
            if there.value >= curvature.value:
                T = T_try
                break
            delta = 0.25 * delta
        else:
            break
        if small or step + 1 == steps:
            break
        pairs = near_pairs(view.cells, target.points, source.points, T, cut)
        curvature = SurfaceCurvature.of(pairs, target, source, T, lengthscale, across, cut)
    return T, curvature, small


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
    and a pair belongs to one point of each cloud and would otherwise count twice.

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
    of_target = _block_sums(view.arrays.points, by_target, block)
    of_source = _block_sums(source.points, by_source, block)
    spread = of_source.T @ of_source + of_target.T @ of_target - pairs
    values, axes = np.linalg.eigh(spread)
    floored: FloatArray = (axes * np.maximum(values, 1e-12 * max(values[-1], 1e-30))) @ axes.T
    return floored


def _block_sums(points: FloatArray, pulls: FloatArray, block: float) -> FloatArray:
    """Sums (b, 6) of pulls (N, 6) over the points (N, 3) in each cell of a grid."""
    cell = np.floor(points / block).astype(np.int64)
    cell -= cell.min(axis=0)
    shape = cell.max(axis=0) + 1
    flat = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(flat, kind="stable")
    starts = np.flatnonzero(np.diff(flat[order], prepend=-1))
    sums: FloatArray = np.add.reduceat(pulls[order], starts, axis=0)
    return sums


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
    width, traits = target.features.shape[1], target.labels.shape[1]
    channels = width // 3
    by_target = np.zeros((len(target.points), 6))
    by_source = np.zeros((len(source.points), 6))
    pairs = np.zeros((6, 6))
    pull = np.empty(6)
    turned = np.empty(width, np.float32)
    R, t = np.ascontiguousarray(T[:3, :3]), T[:3, 3].copy()
    for j in range(len(source.points)):
        y = R @ source.points[j] + t
        m = R @ source.normals[j]
        for c in range(channels):
            for a in range(3):
                turned[a * channels + c] = (
                    T[a, 0] * source.features[j, c]
                    + T[a, 1] * source.features[j, channels + c]
                    + T[a, 2] * source.features[j, 2 * channels + c]
                )
        for at in range(near.start[j], near.start[j + 1]):
            p = near.target[at]
            d0 = target.points[p, 0] - y[0]
            d1 = target.points[p, 1] - y[1]
            d2 = target.points[p, 2] - y[2]
            distance2 = d0 * d0 + d1 * d1 + d2 * d2
            n0, n1, n2 = target.normals[p, 0], target.normals[p, 1], target.normals[p, 2]
            dot = n0 * m[0] + n1 * m[1] + n2 * m[2]
            r = n0 * d0 + n1 * d1 + n2 * d2
            q = m[0] * d0 + m[1] * d1 + m[2] * d2
            both = 0.5 * source.weights[j] * target.weights[p] * dot * dot
            if traits:
                c_xz = 0.0
                for c in range(traits):
                    c_xz += target.labels[p, c] * source.labels[j, c]
                both *= c_xz
            if width:
                s = np.float32(0.0)
                for c in range(width):
                    s += target.features[p, c] * turned[c]
                both *= math.tanh(1.0 + s)
            iso = distance2 * a_iso
            w = both * math.exp(-0.5 * (iso + r * r * a_normal))
            o = both * math.exp(-0.5 * (iso + q * q * a_normal))
            t0 = a_iso * (w + o) * d0 + a_normal * (w * r * n0 + o * q * m[0])
            t1 = a_iso * (w + o) * d1 + a_normal * (w * r * n1 + o * q * m[1])
            t2 = a_iso * (w + o) * d2 + a_normal * (w * r * n2 + o * q * m[2])
            u = a_normal * o * q
            pull[0], pull[1], pull[2] = t0, t1, t2
            pull[3] = y[1] * t2 - y[2] * t1 + u * (d1 * m[2] - d2 * m[1])
            pull[4] = y[2] * t0 - y[0] * t2 + u * (d2 * m[0] - d0 * m[2])
            pull[5] = y[0] * t1 - y[1] * t0 + u * (d0 * m[1] - d1 * m[0])
            for a in range(6):
                by_target[p, a] += pull[a]
                by_source[j, a] += pull[a]
                for b in range(6):
                    pairs[a, b] += pull[a] * pull[b]
    return by_target, by_source, pairs
