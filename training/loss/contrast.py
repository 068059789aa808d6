"""Losses that keep wrong poses and wrong points wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor, nn

from model.cloud_function import CloudFunction
from model.kernel import squared_distances
from model.se3 import axis_angle_rotation, pose_matrix
from model.search.matching import invariants
from training.loss.alignment import Alignment, weighted_mean


class PoseContrast(nn.Module):
    """Softmax over ρ: a reference pose against perturbed ones, features encoded once and rotated.

    Args:
        reference: ``made`` uses the transform that the data pipeline made (self-supervised);
            ``solved`` only ĥ.
        poses: perturbed poses a pair.
        sharpness: factor of ρ in the softmax.
        points: points of each cloud that are compared.
        angles: perturbation, in degrees; drawn log-uniformly.
        shift: standard deviation of the perturbation's translation.
        lengthscales: range of ℓ, drawn uniformly for each batch.
    """

    def __init__(
        self,
        reference: Literal["made", "solved"] = "made",
        poses: int = 7,
        sharpness: float = 20.0,
        points: int = 300,
        angles: tuple[float, float] = (9.0, 178.0),
        shift: float = 0.1,
        lengthscales: tuple[float, float] = (0.05, 0.35),
    ) -> None:
        super().__init__()
        self.uses_made_transform = reference == "made"
        self.uses_solution = reference == "solved"
        self.poses = poses
        self.sharpness = sharpness
        self.points = points
        self.angles = angles
        self.shift = shift
        self.lengthscales = lengthscales

    def forward(self, alignment: Alignment) -> Tensor:
        """Scalar cross entropy."""
        a = alignment.thinned(self.points)
        T = a.T_made if self.uses_made_transform else a.T_solved
        weight = _weight(a, self.uses_made_transform)
        low, high = self.lengthscales
        ell = low + (high - low) * torch.rand((), generator=a.generator)
        ells = ell.expand(len(T))
        xx = a.kernel.inner_product(a.target, a.target, ells)
        zz = a.kernel.inner_product(a.source, a.source, ells)
        norm = (xx * zz).sqrt()
        candidates = [T, *(self._perturbed(a, T) for _ in range(self.poses))]
        rho = torch.stack(
            [a.kernel.inner_product(a.target, a.source_at(c), ells) / norm for c in candidates], 1
        )
        loss = -(self.sharpness * rho).log_softmax(1)[:, 0]
        return weighted_mean(loss, weight)

    def _perturbed(self, a: Alignment, T: Tensor) -> Tensor:
        """Turn the moved source about its centroid and shift it."""
        B, g = len(T), a.generator
        low, high = (math.log(math.radians(angle)) for angle in self.angles)
        angle = (low + (high - low) * torch.rand(B, generator=g)).exp()
        R = axis_angle_rotation(torch.randn(B, 3, generator=g), angle)
        mask = a.source.mask[..., None]
        centre = (a.source_at(T).points * mask).sum(1) / mask.sum(1)
        shift = self.shift * torch.randn(B, 3, generator=g)
        t = centre - (R @ centre[..., None])[..., 0] + shift
        return pose_matrix(R, t) @ T


class MatchingContrast(nn.Module):
    """Each target point against all source points, matched by how alike their features are.

    Args:
        likeness: of the target's points (B, N) and of the moved source's (B, M), (B, N, M).
        reference: ``made`` uses the transform that the data pipeline made (self-supervised, never
            a measured one); ``solved`` only ĥ, which then tells by itself what matches.
        points: points of each cloud that are compared.
        neighbourhood: points this close in the aligned frame count as the same.
        temperature: initial factor of the likeness in the softmax; learned.
        groups: of channels that are matched each by itself, as an encoder of several scales has.
    """

    def __init__(
        self,
        likeness: Callable[[CloudFunction, CloudFunction], Tensor],
        reference: Literal["made", "solved"] = "made",
        points: int = 400,
        neighbourhood: float = 0.05,
        temperature: float = 10.0,
        groups: int = 1,
    ) -> None:
        super().__init__()
        self.likeness = likeness
        self.uses_made_transform = reference == "made"
        self.uses_solution = reference == "solved"
        self.points = points
        self.neighbourhood = neighbourhood
        self.log_temperature = nn.Parameter(torch.tensor(math.log(temperature)))
        self.groups = groups

    def forward(self, alignment: Alignment) -> Tensor:
        """Scalar cross entropy, the mean over the groups."""
        a = alignment.thinned(self.points)
        moved = a.source_at(a.T_made if self.uses_made_transform else a.T_solved.detach())
        weight = _weight(a, self.uses_made_transform)
        targets, sources = a.target.grouped(self.groups), moved.grouped(self.groups)
        entropies = [
            matching_cross_entropy(
                target,
                source,
                self.log_temperature.exp() * self.likeness(target, source),
                self.neighbourhood,
                weight,
            )
            for target, source in zip(targets, sources, strict=True)
        ]
        return torch.stack(entropies).mean()


def feature_likeness(target: CloudFunction, moved: CloudFunction) -> Tensor:
    """Cosine of f and R g: the vectors as they stand at the pose."""
    f, g = _unit(target.features.flatten(2)), _unit(moved.features.flatten(2))
    return f @ g.transpose(-1, -2)


def invariant_likeness(target: CloudFunction, moved: CloudFunction) -> Tensor:
    """Cosine of the Gram matrices FᵀF, which don't turn: what the search matches by."""
    return invariants(target) @ invariants(moved).transpose(-1, -2)


def matching_cross_entropy(
    target: CloudFunction,
    moved: CloudFunction,
    logits: Tensor,
    neighbourhood: float,
    weight: Tensor,
) -> Tensor:
    """Softmax over the source for each target point; the right answers are soft, by distance.

    Args:
        target: N points each.
        moved: the source in the target's frame, M points each.
        logits: (B, N, M).
        neighbourhood: standard deviation of the Gaussian that says how right an answer is.
        weight: (B,) of the pairs.
    """
    distance2 = squared_distances(target.points, moved.points)
    rightness = torch.exp(distance2 / (-2.0 * neighbourhood**2))
    per_point = -(rightness * logits.log_softmax(-1)).sum(-1)
    matched = rightness.sum(-1).sum(-1)
    per_pair = per_point.sum(-1) / matched.clamp_min(1.0)
    return weighted_mean(per_pair, weight)


def _weight(a: Alignment, uses_made_transform: bool) -> Tensor:
    return a.is_synthetic.to(a.confidence.dtype) if uses_made_transform else a.confidence


def _unit(features: Tensor) -> Tensor:
    return nn.functional.normalize(features, dim=-1)
