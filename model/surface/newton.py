"""The last steps on the surface kernel: Newton's, to the maximum of the sum."""

from __future__ import annotations

import numpy as np

from model.surface.arrays import SurfaceArrays
from model.surface.cells import FloatArray
from model.surface.cloud import CellView
from model.surface.curvature import SurfaceCurvature, surface_curvature
from model.surface.descent import retracted
from model.surface.near_pairs import near_pairs
from model.surface.product import surface_sum

_TRIES = 5
# The pairs that are listed stay while the pose moves a little: none comes or goes meanwhile.
_WIDER = 1.01
# Sums of the same terms by two loops differ by less.
_ROUNDED = 1.0 - 1e-12


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
    curvature = surface_curvature(pairs, target, source, T, lengthscale, across, _WIDER * cut)
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
            there = surface_sum(pairs, target, source, T_try, lengthscale, across, _WIDER * cut)
            if there >= _ROUNDED * curvature.value:
                T = T_try
                break
            delta = 0.25 * delta
        else:
            break
        if small or step + 1 == steps:
            break
        pairs = near_pairs(view.cells, target.points, source.points, T, cut)
        curvature = surface_curvature(pairs, target, source, T, lengthscale, across, _WIDER * cut)
    return T, curvature, small
