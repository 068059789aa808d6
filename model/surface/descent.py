"""Gauss–Newton steps on the surface kernel."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from model.compiled import compiled
from model.surface.arrays import SurfaceArrays
from model.surface.cells import Cells, FloatArray
from model.surface.moments import REACH, SurfaceMoments, surface_moments
from model.surface.near_pairs import SLACK, farthest_move, near_pairs

_DAMPING = 1e-6
_SOFTEST = 0.1
# Pairs that come and go at the kernel's end change S by more than this.
_NO_GAIN = 1e-6
_HALVINGS = 4


class Descent(NamedTuple):
    """Where steps at one ℓ led.

    Attributes:
        T_target_source: (4, 4).
        value: S there.
        steady: whether the last step was below the tolerance, or none would raise S.
        values: (steps,) S before each step that was taken.
        deltas: (steps, 6) δ of each.
    """

    T_target_source: FloatArray
    value: float
    steady: bool
    values: FloatArray
    deltas: FloatArray


@compiled
def descend(
    cells: Cells,
    target: SurfaceArrays,
    source: SurfaceArrays,
    T: FloatArray,
    lengthscale: float,
    across: float,
    steps: int,
    tolerance: float,
) -> Descent:
    """Raise S from T (4, 4); a step that would lower it is halved, then given up.

    Args:
        cells: of the target, at least ``VIEW`` ℓ in size.
        target: in cell order.
        source: in any order.
        T: where to start.
        lengthscale: ℓ along the surface.
        across: ℓ_n across it.
        steps: at most this many.
        tolerance: a step with ‖δ‖ below this ends the descent, as does one that promises nothing.
    """
    cut = REACH * lengthscale
    T = T.copy()
    values, deltas, count = np.zeros(steps), np.zeros((steps, 6)), 0
    T_listed = T
    pairs = near_pairs(cells, target.points, source.points, T, SLACK * cut)
    here = surface_moments(pairs, target, source, T, lengthscale, across, cut)
    for _ in range(steps):
        if here.value <= 1e-12:
            break
        delta = newton_step(here)
        size = math.sqrt((delta * delta).sum())
        promised = 0.5 * (here.gradient * delta).sum()
        if size <= tolerance or promised <= _NO_GAIN * here.value:
            return Descent(T, here.value, True, values[:count], deltas[:count])
        improved = False
        for _ in range(_HALVINGS):
            T_try = retracted(T, delta)
            if farthest_move(source.points, T_listed, T_try) > (SLACK - 1.0) * cut:
                T_listed = T_try
                pairs = near_pairs(cells, target.points, source.points, T_try, SLACK * cut)
            there = surface_moments(pairs, target, source, T_try, lengthscale, across, cut)
            if there.value > here.value:
                improved = True
                break
            delta = 0.5 * delta
        if not improved:
            return Descent(T, here.value, True, values[:count], deltas[:count])
        values[count], deltas[count] = here.value, delta
        count += 1
        T, here = T_try, there
    return Descent(T, here.value, False, values[:count], deltas[:count])


@compiled
def newton_step(moments: SurfaceMoments) -> FloatArray:
    """δ (6,) by the stiffness less the softening, slightly damped where it is singular.

    The stiffness alone makes steps that are always safe and, where every point has several
    neighbours, several times too short. Seen from it, the difference has eigenvalues up to 1; those
    below ``_SOFTEST`` are raised to it, so that no step is longer than a few safe ones.
    """
    H = moments.stiffness.copy()
    shift, turn = H[0, 0] + H[1, 1] + H[2, 2], H[3, 3] + H[4, 4] + H[5, 5]
    for a in range(3):
        H[a, a] += _DAMPING * shift + 1e-30
        H[a + 3, a + 3] += _DAMPING * turn + 1e-30
    inverse = np.linalg.inv(np.linalg.cholesky(H))
    softened = np.eye(6) - inverse @ moments.softening @ inverse.T
    values, axes = np.linalg.eigh(0.5 * (softened + softened.T))
    along = axes.T @ (inverse @ moments.gradient)
    step = axes @ (along / np.maximum(values, _SOFTEST))
    delta: FloatArray = inverse.T @ step
    return delta


@compiled
def retracted(T: FloatArray, delta: FloatArray) -> FloatArray:
    """Exp(φ) and ρ applied on the left of T (4, 4): R' = Exp(φ) R, t' = Exp(φ) t + V(φ) ρ."""
    phi = delta[3:]
    angle2 = (phi * phi).sum()
    angle = math.sqrt(angle2)
    if angle < 1e-6:
        a, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
        c = (1.0 - a) / angle2
    K = np.array([[0.0, -phi[2], phi[1]], [phi[2], 0.0, -phi[0]], [-phi[1], phi[0], 0.0]])
    K2 = K @ K
    E = np.eye(3) + a * K + b * K2
    V = np.eye(3) + b * K + c * K2
    out = np.zeros((4, 4))
    out[:3, :3] = E @ np.ascontiguousarray(T[:3, :3])
    out[:3, 3] = E @ np.ascontiguousarray(T[:3, 3]) + V @ np.ascontiguousarray(delta[:3])
    out[3, 3] = 1.0
    return out
