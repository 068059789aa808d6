"""The exact objective on near pairs only: what the RBF leaves of the double sum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.cloud_function import CloudFunction
from model.kernel import RkhsKernel
from model.kernel.feature_kernel import feature_kernel
from model.kernel.moments import PoseMoments

# exp(−3²/2) = 0.011: what lies beyond is left out, and is left out of ⟨X,X⟩ and ⟨Z,Z⟩ as well.
REACH = 3.0


@dataclass(frozen=True, slots=True)
class NearPairs:
    """Pairs (x, z) that are near at some pose, with all a kernel needs of them.

    The feature product at any rotation is s = ⟨R, Σ_c f_c g_cᵀ⟩, so the 3×3 matrix replaces the
    features: a step costs nine products a pair, whatever the number of channels.

    Attributes:
        x: (B, M, k, 3) target points near each source point.
        z: (B, M, 3) source points.
        turning: (B, M, k, 3, 3) Σ_c f_c g_cᵀ, or None without features.
        weight: (B, M, k) c_ij, and 0 where a source point has fewer near ones.
        index: (B, M, k) which target point each is.
        kernel: name of the feature kernel.
    """

    x: Tensor
    z: Tensor
    turning: Tensor | None
    weight: Tensor
    index: Tensor
    kernel: str

    def double(self) -> NearPairs:
        """The same pairs in float64, for derivatives that cancel."""
        turning = None if self.turning is None else self.turning.double()
        return replace(
            self, x=self.x.double(), z=self.z.double(), turning=turning, weight=self.weight.double()
        )

    @classmethod
    def at(
        cls,
        kernel: RkhsKernel,
        target: CloudFunction,
        source: CloudFunction,
        T: Tensor,
        reach: float,
        most: int,
        tree: KDTree | None = None,
    ) -> NearPairs:
        """Collect the pairs that are near at the poses T (B, 4, 4).

        Args:
            kernel: of the RKHS.
            target: one cloud (1, N, …).
            source: one cloud (1, M, …).
            T: poses; each gets its own pairs.
            reach: pairs farther apart are left out.
            most: at most this many target points, the nearest, for each source point.
            tree: of the target's points, if there is one already.
        """
        x, z = target.points[0], source.points[0]
        tree = KDTree(x.numpy()) if tree is None else tree
        y = z @ T[:, :3, :3].transpose(-1, -2) + T[:, None, :3, 3]
        _, found = tree.query(
            y.reshape(-1, 3).numpy(), k=most, distance_upper_bound=reach, workers=-1
        )
        index = torch.from_numpy(found).reshape(len(T), len(z), most)
        real = index < len(x)
        index = index.clamp(max=len(x) - 1)
        weight = real.to(x.dtype) * target.mask[0][index] * source.mask[0][:, None]
        if target.labels is not None and source.labels is not None:
            weight = weight * (target.labels[0][index] * source.labels[0][:, None]).sum(-1)
        batch_z = z.expand(len(T), -1, -1)
        turning = _turning(kernel, target, source, index)
        return cls(x[index], batch_z, turning, weight, index, kernel.name)

    def moments(self, T_target_source: Tensor, lengthscale: Tensor) -> PoseMoments:
        """Of the near pairs' share of ⟨X, hZ⟩ at poses (B, 4, 4) and ℓ (B,)."""
        R, t = T_target_source[:, :3, :3], T_target_source[:, :3, 3]
        y = self.z @ R.transpose(-1, -2) + t[:, None]
        distance2 = (self.x - y[:, :, None]).square().sum(-1)
        value, slope = self.terms(R, distance2, lengthscale)
        value_x = torch.einsum("bmk,bmkd->bmd", value, self.x)
        value_y = value.sum(-1)
        return PoseMoments(
            mass=value_y.sum(-1),
            mass_x=value_x.sum(1),
            mass_y=(value_y[:, None] @ y)[:, 0],
            outer=value_x.transpose(-1, -2) @ y,
            feature_outer=self._feature_outer(slope, R),
            scatter=(value * distance2).sum((-1, -2)),
        )

    def mass(self, T_target_source: Tensor, lengthscale: Tensor) -> Tensor:
        """⟨X, hZ⟩ alone, (B,), at poses (B, 4, 4) and ℓ (B,)."""
        R, t = T_target_source[:, :3, :3], T_target_source[:, :3, 3]
        y = self.z @ R.transpose(-1, -2) + t[:, None]
        distance2 = (self.x - y[:, :, None]).square().sum(-1)
        return self.terms(R, distance2, lengthscale)[0].sum((-1, -2))

    def terms(self, R: Tensor, distance2: Tensor, lengthscale: Tensor) -> tuple[Tensor, Tensor]:
        """W and v of ``KernelTerms``, each (B, M, k)."""
        rbf = torch.exp(distance2 / (-2.0 * lengthscale.square())[:, None, None]) * self.weight
        if self.turning is None:
            return rbf, torch.zeros_like(rbf)
        kappa, slope, _ = feature_kernel(self.kernel).evaluate(self.feature_product(R))
        return rbf * kappa, rbf * slope

    def feature_product(self, R: Tensor) -> Tensor:
        """s_ij at rotations (B, 3, 3), (B, M, k)."""
        assert self.turning is not None
        flat = self.turning.flatten(-2)
        return (flat @ R.flatten(-2)[:, None, :, None])[..., 0]

    def _feature_outer(self, slope: Tensor, R: Tensor) -> Tensor:
        if self.turning is None:
            return torch.zeros_like(R)
        total = slope.flatten(1)[:, None] @ self.turning.flatten(-2).flatten(1, 2)
        return total.reshape(-1, 3, 3) @ R.transpose(-1, -2)


def _turning(
    kernel: RkhsKernel, target: CloudFunction, source: CloudFunction, index: Tensor
) -> Tensor | None:
    if target.features.shape[-1] == 0 or kernel.name == "none":
        return None
    f = kernel.matched_features(target)[0][index]
    g = kernel.matched_features(source)[0]
    return f @ g.transpose(-1, -2)[None, :, None]


@dataclass(frozen=True, slots=True)
class NearObjective:
    """⟨X, hZ⟩ and the norms on near pairs, for poses that stay near those it was built at.

    Attributes:
        pairs: of target and source.
        target_pairs: of the target with itself.
        source_pairs: of the source with itself.
        target: (1, N, …).
        source: (1, M, …).
    """

    pairs: NearPairs
    target_pairs: NearPairs
    source_pairs: NearPairs
    target: CloudFunction
    source: CloudFunction

    @classmethod
    def at(
        cls,
        kernel: RkhsKernel,
        target: CloudFunction,
        source: CloudFunction,
        T: Tensor,
        reach: float,
        most: int,
        tree: KDTree | None = None,
    ) -> NearObjective:
        """Collect all pairs nearer than ``reach`` at the pose T (1, 4, 4); see NearPairs.at."""
        tree = KDTree(target.points[0].numpy()) if tree is None else tree
        identity = torch.eye(4, dtype=T.dtype)[None]
        return cls(
            NearPairs.at(kernel, target, source, T, reach, most, tree),
            NearPairs.at(kernel, target, target, identity, reach, most, tree),
            NearPairs.at(kernel, source, source, identity, reach, most),
            target,
            source,
        )

    def elsewhere(self, kernel: RkhsKernel, T: Tensor, lengthscale: Tensor) -> Tensor:
        """⟨X, hZ⟩ at other poses (K, 4, 4) and ℓ (K,), (K,)."""
        reach, most = REACH * float(lengthscale.max()), self.pairs.x.shape[2]
        pairs = NearPairs.at(kernel, self.target, self.source, T, reach, most)
        return pairs.mass(T, lengthscale)

    def moments(self, T_target_source: Tensor, lengthscale: Tensor) -> PoseMoments:
        """See Objective."""
        return self.pairs.moments(T_target_source, lengthscale)

    def own_moments(self, lengthscale: Tensor) -> tuple[PoseMoments, PoseMoments]:
        """See Objective."""
        identity = torch.eye(4, dtype=lengthscale.dtype)[None]
        return (
            self.target_pairs.moments(identity, lengthscale),
            self.source_pairs.moments(identity, lengthscale),
        )
