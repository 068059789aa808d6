"""Loud warnings when a training learns nothing."""

from __future__ import annotations

import warnings
from collections.abc import Mapping

from torch import Tensor

from training.curriculum import Stage

# Below this the channels all say the same.
_COLLAPSED_RANK = 1.5
_EMPTY_KERNEL = 0.9999


class CollapseWarning(UserWarning):
    """The training is learning nothing: the message names the metric."""


def warn_of_collapse(values: Mapping[str, Tensor], stage: Stage, inner_loop: str) -> None:
    """Warn where features collapse, ℓ hits its bound or the kernel empties.

    Args:
        values: the validation's metrics by name.
        stage: whose bounds hold.
        inner_loop: only ``gradient`` moves ℓ by itself.
    """
    low, high = stage.lengthscale_bounds
    rank, ell = float(values["effective_rank"]), float(values["lengthscale"])
    sparsity = float(values["kernel_sparsity"])
    alarms = []
    if rank < _COLLAPSED_RANK:
        alarms.append(f"effective_rank {rank:.2f}: the features collapse")
    if inner_loop == "gradient" and not low * 1.01 < ell < high * 0.99:
        alarms.append(f"lengthscale {ell:.3f} is at its bound [{low}, {high}]")
    if sparsity > _EMPTY_KERNEL:
        alarms.append(f"kernel_sparsity {sparsity:.4f}: the kernel empties")
    for alarm in alarms:
        warnings.warn(f"COLLAPSE ALARM: {alarm}", CollapseWarning, stacklevel=2)
