"""The RKHS of point-cloud functions: k, ⟨·,·⟩, d and ρ (paper, sections 3, 4.2 and 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from model.cloud_function import CloudFunction, label_product, pair_mask
from model.kernel.feature_kernel import FeatureKernel, feature_kernel


@dataclass(frozen=True, slots=True)
class KernelTerms:
    """What every derivative of ⟨X, hZ⟩ is made of, each (B, N, M).

    Attributes:
        value: w_ij = c_ij RBF_ij κ(s_ij), the summands of ⟨X, hZ⟩.
        slope: v_ij = c_ij RBF_ij κ'(s_ij), their derivative with respect to s_ij.
        squared_distance: ‖x_i − z_j‖².
    """

    value: Tensor
    slope: Tensor
    squared_distance: Tensor


@dataclass(frozen=True, slots=True)
class InnerProducts:
    """⟨X,X⟩, ⟨Z,Z⟩ and ⟨X,hZ⟩ of a batch at one ℓ, each (B,)."""

    target: Tensor
    source: Tensor
    cross: Tensor

    @property
    def distance(self) -> Tensor:
        """d(f_X, f_hZ) = ⟨X,X⟩ + ⟨Z,Z⟩ − 2⟨X,hZ⟩, (B,) (paper, section 4.2)."""
        return self.target + self.source - 2.0 * self.cross

    @property
    def similarity(self) -> Tensor:
        """ρ = ⟨X,hZ⟩ / √(⟨X,X⟩⟨Z,Z⟩), (B,): 1 for equal functions, free of size and scale."""
        tiny = torch.finfo(self.cross.dtype).tiny
        return self.cross / (self.target * self.source).clamp_min(tiny).sqrt()

    def detach(self) -> InnerProducts:
        """The same values outside the autograd graph."""
        return InnerProducts(self.target.detach(), self.source.detach(), self.cross.detach())


def squared_distances(x: Tensor, z: Tensor) -> Tensor:
    """‖x_i − z_j‖² as (B, N, M), by one matrix product."""
    x2 = x.square().sum(-1)[..., :, None]
    z2 = z.square().sum(-1)[..., None, :]
    product = x @ z.transpose(-1, -2)
    return (x2 + z2 - 2.0 * product).clamp_min(0.0)


class RkhsKernel:
    """k(x⊕f, z⊕g) = exp(−‖x−z‖²/2ℓ²) · κ(f·g), summed over pairs of points.

    The paper prints the RBF without its minus sign, a misprint. With tanh the kernel isn't
    positive definite, so d can fall slightly below zero; with ``exponential`` it can't.
    """

    def __init__(self, feature: str = "tanh") -> None:
        self._feature: FeatureKernel = feature_kernel(feature)

    @property
    def name(self) -> str:
        """The feature kernel's name."""
        return self._feature.name

    def terms(
        self, target: CloudFunction, source: CloudFunction, lengthscale: Tensor
    ) -> KernelTerms:
        """Evaluate the kernel on every pair of points.

        Args:
            target: N points each.
            source: M points each, already moved by h.
            lengthscale: (B,) ℓ.
        """
        distance2 = squared_distances(target.points, source.points)
        rbf = torch.exp(-distance2 / (2.0 * lengthscale.square())[:, None, None])
        rbf = rbf * pair_mask(target, source)
        labels = label_product(target, source)
        if labels is not None:
            rbf = rbf * labels
        if target.features.shape[-1] == 0 or self._feature.name == "none":
            return KernelTerms(rbf, torch.zeros_like(rbf), distance2)
        kappa, kappa_slope, _ = self._feature.evaluate(self.feature_product(target, source))
        return KernelTerms(rbf * kappa, rbf * kappa_slope, distance2)

    def feature_product(self, target: CloudFunction, source: CloudFunction) -> Tensor:
        """s_ij = Σ_c f_ic · g_jc as (B, N, M); the cosine where the kernel asks for it."""
        f = self.matched_features(target).flatten(-2)
        g = self.matched_features(source).flatten(-2)
        return f @ g.transpose(-1, -2)

    def matched_features(self, cloud: CloudFunction) -> Tensor:
        """The features as the kernel compares them: of unit length for a cosine kernel."""
        if not self._feature.cosine:
            return cloud.features
        norm = cloud.features.square().sum((-1, -2), keepdim=True).clamp_min(1e-12).sqrt()
        return cloud.features / norm

    def inner_product(
        self, target: CloudFunction, source: CloudFunction, lengthscale: Tensor
    ) -> Tensor:
        """⟨f_X, f_Z⟩ = Σ_ij c_ij k(x_i⊕f_i, z_j⊕g_j), (B,)."""
        return self.terms(target, source, lengthscale).value.sum((-1, -2))

    def products(
        self, target: CloudFunction, source: CloudFunction, lengthscale: Tensor
    ) -> InnerProducts:
        """All three inner products of a pair, from which d and ρ follow."""
        return InnerProducts(
            target=self.inner_product(target, target, lengthscale),
            source=self.inner_product(source, source, lengthscale),
            cross=self.inner_product(target, source, lengthscale),
        )
