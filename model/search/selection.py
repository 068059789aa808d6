"""Which of several poses is right."""

from __future__ import annotations

import torch
from torch import Tensor

from model.inner_loop.near_objective import REACH, NearPairs

FINE_LENGTHSCALE = 0.03
COARSE_LENGTHSCALE = 0.06
# How far the pairs have to reach for the coarse kernel.
SELECTION_REACH = REACH * COARSE_LENGTHSCALE


def selection_score(
    pairs: NearPairs, T_target_source: Tensor, support: Tensor, resolution: float = 1.0
) -> Tensor:
    """⟨X, hZ⟩ at a fine ℓ, weighted by its ratio to the one at a coarse ℓ and by votes, (K,).

    Under partial overlap the kernel sum alone prefers poses that overlap too much but fit loosely;
    those lose most of their sum when ℓ shrinks, the true pose loses least (design, section 6).
    Matches that agree on a pose are evidence of another kind: they enter by their square root.

    Args:
        pairs: near at the K poses, as far as ``SELECTION_REACH`` times the resolution.
        T_target_source: (K, 4, 4).
        support: (K,) votes for each.
        resolution: stretches both lengthscales for sparse clouds.
    """
    ones = torch.ones_like(T_target_source[:, 0, 0])
    fine = pairs.mass(T_target_source, ones * (FINE_LENGTHSCALE * resolution))
    coarse = pairs.mass(T_target_source, ones * (COARSE_LENGTHSCALE * resolution))
    # κ = tanh(1 + s) is negative for features that turn against each other: such a pose is wrong.
    fine = fine.clamp_min(0.0)
    tightness = (fine / coarse.clamp_min(1e-6)).clamp(max=1.0) * (coarse > 0)
    return fine * tightness * (1.0 + support).sqrt()
