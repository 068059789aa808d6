"""Which of several solved poses is right."""

from __future__ import annotations

from torch import Tensor

from model.cloud_function import CloudFunction
from model.kernel import RkhsKernel

FINE_LENGTHSCALE = 0.04
COARSE_LENGTHSCALE = 0.08


def selection_score(
    kernel: RkhsKernel,
    target: CloudFunction,
    source: CloudFunction,
    T_target_source: Tensor,
    resolution: float = 1.0,
) -> Tensor:
    """⟨X, hZ⟩ at a fine ℓ, weighted by its ratio to the one at a coarse ℓ, (K,).

    Under partial overlap the kernel sum alone prefers poses that overlap too much but fit loosely;
    those lose most of their sum when ℓ shrinks, the true pose loses least (design, section 6).

    Args:
        kernel: of the RKHS.
        target: (1, N, …) or (K, N, …).
        source: (1, M, …) or (K, M, …).
        T_target_source: (K, 4, 4).
        resolution: stretches both lengthscales for sparse clouds.
    """
    K = len(T_target_source)
    target, source = target.expand(K), source.expand(K)
    moved = source.transformed(T_target_source[:, :3, :3], T_target_source[:, :3, 3])
    ones = T_target_source.new_ones(K)
    fine = kernel.inner_product(target, moved, ones * (FINE_LENGTHSCALE * resolution))
    coarse = kernel.inner_product(target, moved, ones * (COARSE_LENGTHSCALE * resolution))
    return fine.square() / coarse.clamp_min(1e-12)
