"""Geometric-CVO: the paper's gradient flow on the kernel without features."""

from __future__ import annotations

from benchmarks.methods.single_start import SingleStart
from model.inner_loop import GradientLoop
from model.kernel import RkhsKernel


def geometric_cvo() -> SingleStart:
    """From one start, with the paper's step rule: ℓ moves with the pose, at a hundredth of it."""
    return SingleStart("geometric_cvo", RkhsKernel("none"), None, GradientLoop(), {})
