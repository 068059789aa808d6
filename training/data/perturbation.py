"""What sensors do to a cloud: noise, outliers, crops, other samples, other sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Generator, Tensor

from model.exceptions import InvalidOptionError

CropRule = Literal["half_space", "released_code"]


@dataclass(frozen=True)
class Perturbation:
    """Ranges from which every cloud of a pair draws for itself; lengths are in unit spheres.

    Attributes:
        sigma: standard deviation of the noise.
        outlier_share: share of points displaced along their normal.
        outlier_reach: outliers are displaced uniformly by at most this much either way.
        crop_share: share of points cut off.
        crop_rule: ``half_space`` cuts beyond a plane in a random direction and leaves fewer points;
            ``released_code`` cuts at a random end of a random coordinate axis and repeats random
            remaining points up to the old number, as the code released with the paper does.
        target_points: least and most points N drawn from the shape, before any crop.
        source_points: the same for M.
        noise_probability: of a cloud's having noise at all.
        outlier_probability: of its having outliers.
        crop_probability: of its being cropped.
        resample_probability: of the two clouds' having no point in common; otherwise the smaller
            one's points are all among the larger one's, in another order.

    Raises:
        InvalidOptionError: a range is reversed or beyond what it can be.
    """

    sigma: tuple[float, float] = (0.0, 0.0)
    outlier_share: tuple[float, float] = (0.0, 0.0)
    outlier_reach: float = 0.1
    crop_share: tuple[float, float] = (0.0, 0.0)
    crop_rule: CropRule = "half_space"
    target_points: tuple[int, int] = (1024, 1024)
    source_points: tuple[int, int] = (1024, 1024)
    noise_probability: float = 1.0
    outlier_probability: float = 1.0
    crop_probability: float = 1.0
    resample_probability: float = 1.0

    def __post_init__(self) -> None:
        _require_range("sigma", self.sigma, 0.0, math.inf)
        _require_range("outlier_share", self.outlier_share, 0.0, 1.0)
        _require_range("outlier_reach", (0.0, self.outlier_reach), 0.0, math.inf)
        _require_range("crop_share", self.crop_share, 0.0, 0.9)
        _require_range("target_points", self.target_points, 4, math.inf)
        _require_range("source_points", self.source_points, 4, math.inf)
        for name in ("noise", "outlier", "crop", "resample"):
            field = f"{name}_probability"
            _require_range(field, (0.0, getattr(self, field)), 0.0, 1.0)
        if self.crop_rule not in ("half_space", "released_code"):
            raise InvalidOptionError(
                "no such crop rule",
                field="crop_rule",
                value=self.crop_rule,
                mend="use half_space or released_code",
            )

    @property
    def points_needed(self) -> int:
        """How many points a shape must have for the largest pair this asks for."""
        most = (self.target_points[1], self.source_points[1])
        return sum(most) if self.resample_probability > 0.0 else max(most)


def _require_range(
    field: str, limits: tuple[float, float], smallest: float, largest: float
) -> None:
    low, high = limits
    if not smallest <= low <= high <= largest:
        raise InvalidOptionError(
            f"outside of {smallest:g} to {largest:g}, or reversed",
            field=f"perturbation.{field}",
            value=list(limits),
            mend="give the least value, then the greatest",
        )


def perturbed(
    points: Tensor, normals: Tensor | None, perturbation: Perturbation, generator: Generator
) -> tuple[Tensor, Tensor | None]:
    """Noise, then outliers, then a crop, each by its own chance and strength.

    Args:
        points: (N, 3).
        normals: (N, 3) unit normals, or None: displacements then go in random directions.
        perturbation: the ranges.
        generator: source of the draws.

    Returns:
        Points (N', 3) and normals (N', 3) or None; N' < N only after a ``half_space`` crop.
    """
    if _happens(perturbation.noise_probability, generator):
        sigma = _drawn(perturbation.sigma, generator)
        points = with_noise(points, normals, sigma, generator)
    if _happens(perturbation.outlier_probability, generator):
        share = _drawn(perturbation.outlier_share, generator)
        points = with_outliers(points, normals, share, perturbation.outlier_reach, generator)
    if _happens(perturbation.crop_probability, generator):
        share = _drawn(perturbation.crop_share, generator)
        crop = half_space_crop if perturbation.crop_rule == "half_space" else released_code_crop
        kept = crop(points, share, generator)
        points = points[kept]
        normals = None if normals is None else normals[kept]
    return points, normals


def with_noise(
    points: Tensor, normals: Tensor | None, sigma: float, generator: Generator
) -> Tensor:
    """Gaussian noise of standard deviation ``sigma`` along the normals.

    Without normals it is isotropic, ``sigma`` a coordinate.
    """
    if normals is None:
        return points + sigma * torch.randn(points.shape, generator=generator)
    return points + sigma * torch.randn(len(points), 1, generator=generator) * normals


def with_outliers(
    points: Tensor, normals: Tensor | None, share: float, reach: float, generator: Generator
) -> Tensor:
    """Displace ``share`` of the points uniformly by up to ±``reach`` along their normals.

    Without normals each goes in a random direction of its own.
    """
    count = round(share * len(points))
    chosen = torch.randperm(len(points), generator=generator)[:count]
    if normals is None:
        direction = torch.randn(count, 3, generator=generator)
        direction = torch.nn.functional.normalize(direction, dim=1)
    else:
        direction = normals[chosen]
    distance = reach * (2.0 * torch.rand(count, 1, generator=generator) - 1.0)
    return points.index_add(0, chosen, distance * direction)


def half_space_crop(points: Tensor, share: float, generator: Generator) -> Tensor:
    """Indices of what is left when ``share`` of (N, 3) beyond a plane of random direction goes."""
    direction = torch.randn(3, generator=generator)
    kept = torch.argsort(points @ direction)[: len(points) - round(share * len(points))]
    return kept.sort().values


def released_code_crop(points: Tensor, share: float, generator: Generator) -> Tensor:
    """Indices (N,) after ``share`` of (N, 3) at one end of one coordinate axis goes.

    The gap is filled by repeating random remaining points.
    """
    axis = int(torch.randint(3, (1,), generator=generator))
    descending = bool(torch.randint(2, (1,), generator=generator))
    removed = round(share * len(points))
    order = torch.argsort(points[:, axis], descending=descending)
    kept = order[: len(points) - removed].sort().values
    repeated = torch.randint(len(kept), (removed,), generator=generator)
    return torch.cat([kept, kept[repeated]])


def _happens(probability: float, generator: Generator) -> bool:
    return bool(torch.rand((), generator=generator) < probability)


def _drawn(limits: tuple[float, float], generator: Generator) -> float:
    low, high = limits
    return low + (high - low) * float(torch.rand((), generator=generator))
