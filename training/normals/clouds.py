"""Spoilt clouds with the normals of the surface they were taken from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import KDTree
from torch import Tensor

from model.normals.compiled_network import neighbours
from model.surface.patches import Planes
from training.data.motion import Motion
from training.data.normals import with_normals
from training.data.perturbation import Perturbation, perturbed
from training.data.seeding import Stream, derived_seed, torch_generator
from training.data.shape import Shape, ShapeSet

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

# Points farther than this from the surface, in unit spheres, show nothing of it.
_ON_SURFACE = 0.035
_FEWEST = 30
_ANY_TURN = Motion("haar", 180.0, 0.0)


class LabelledCloud(NamedTuple):
    """A cloud, or several, as ``NormalNetwork`` takes it, and what it should answer.

    Attributes:
        points: (N, 3).
        normals: (N, 3) fitted.
        spacing: (N,) of the cloud that each point belongs to.
        i: (E,) points.
        j: (E,) points near them.
        true_normals: (N, 3) of the surface; their signs mean nothing.
        on_surface: (N,) 1 for points that lie on it, 0 for outliers.
        layer: (N,) which of two clouds that meet each is of; 0 in a cloud by itself.
    """

    points: Tensor
    normals: Tensor
    spacing: Tensor
    i: Tensor
    j: Tensor
    true_normals: Tensor
    on_surface: Tensor
    layer: Tensor

    @property
    def graph(self) -> tuple[Tensor, ...]:
        """The network's arguments."""
        return self.points, self.normals, self.spacing, self.i, self.j, self.layer

    @classmethod
    def of(
        cls, points: FloatArray, true_normals: FloatArray, on_surface: Mask, layer: IntArray
    ) -> LabelledCloud:
        """Fit normals to points (N, 3).

        Args:
            points: in any order.
            true_normals: (N, 3) of the surface there.
            on_surface: (N,).
            layer: (N,).

        Returns:
            the cloud in the given order.
        """
        planes = Planes.of(points)
        order = planes.cells.order
        start, rows = neighbours(planes.cells, planes.reach)
        fitted = np.empty_like(points)
        fitted[order] = planes.normals
        return cls(
            torch.from_numpy(points).float(),
            torch.from_numpy(fitted).float(),
            torch.full((len(points),), planes.spacing),
            torch.from_numpy(order[np.repeat(np.arange(len(points)), np.diff(start))]),
            torch.from_numpy(order[rows]),
            torch.from_numpy(true_normals).float(),
            torch.from_numpy(on_surface).float(),
            torch.from_numpy(layer),
        )

    @classmethod
    def joined(cls, clouds: Sequence[LabelledCloud]) -> LabelledCloud:
        """Several as one."""
        before = np.cumsum([0, *(len(cloud.points) for cloud in clouds)]).tolist()
        shifted = [
            cloud._replace(i=cloud.i + first, j=cloud.j + first)
            for cloud, first in zip(clouds, before, strict=False)
        ]
        return cls(*(torch.cat(parts) for parts in zip(*shifted, strict=True)))


def spoiling(points_per_shape: int) -> Perturbation:
    """What the clouds go through: sparse and dense ones, clean and bad."""
    most = min(1400, points_per_shape // 2)
    return Perturbation(
        sigma=(0.0, 0.013),
        noise_probability=0.7,
        outlier_share=(0.05, 0.25),
        outlier_probability=0.5,
        crop_share=(0.05, 0.3),
        crop_probability=0.4,
        target_points=(max(4, most // 5), most),
        source_points=(max(4, most // 5), most),
    )


def labelled_clouds(sources: Sequence[ShapeSet], count: int, seed: int) -> Iterator[LabelledCloud]:
    """Clouds of shapes, the sources in turn.

    Args:
        sources: of shapes.
        count: how many clouds.
        seed: of everything random.
    """
    for number in range(count):
        shapes = sources[number % len(sources)]
        shape = shapes[derived_seed(seed, Stream.TRAINING, number) % len(shapes)]
        generator = torch_generator(derived_seed(seed, Stream.PAIR, number), Stream.PAIR)
        cloud = labelled_cloud(shape, spoiling(len(shape.points)), generator)
        if cloud is not None:
            yield cloud


def labelled_cloud(
    shape: Shape, perturbation: Perturbation, generator: torch.Generator
) -> LabelledCloud | None:
    """Draw points, spoil them, turn them, fit normals; None where too few are left."""
    shape = with_normals(shape)
    dense, normals = shape.points, shape.normals
    assert normals is not None
    low, high = perturbation.target_points
    # Few points are as frequent as many: the logarithm is uniform.
    share = float(torch.rand((), generator=generator))
    rows = torch.randperm(len(dense), generator=generator)[: round(low * (high / low) ** share)]
    points, true = perturbed(dense[rows], normals[rows], perturbation, generator)
    if len(points) < _FEWEST or true is None:
        return None
    x, R = points.double().numpy(), _ANY_TURN.draw(generator)[:3, :3].double().numpy()
    on_surface = lie_on_surface(x, dense.double().numpy())
    alone = np.zeros(len(x), np.int64)
    return LabelledCloud.of(x @ R.T, true.double().numpy() @ R.T, on_surface, alone)


def lie_on_surface(points: FloatArray, surface: FloatArray) -> Mask:
    """(N,) which of points (N, 3) show something of a surface that is given by its own (P, 3)."""
    near: Mask = KDTree(surface).query(points)[0] < _ON_SURFACE
    return near
