"""Pairs of spoilt clouds whose pose was made up here, with the normals of their surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.surface import SurfaceCloud
from training.data.motion import Motion
from training.data.normals import with_normals
from training.data.pairs import pair_of_shape
from training.data.perturbation import Perturbation
from training.data.seeding import Stream, derived_seed, torch_generator
from training.data.shape import Shape, ShapeSet
from training.normals.clouds import LabelledCloud, lie_on_surface

FloatArray = npt.NDArray[np.float64]

# Pairs of this many points a cloud at most are those whose normals are fitted together.
_LEAST, _MOST = 150, 520
_FEWEST = 60
_SEEN = 256
_ANY_TURN = Motion("haar", 180.0, 0.0)
# Where the solver may come from: rotations in degrees and shifts in unit spheres, at most.
_BESIDE = ((2.0, 0.01), (4.0, 0.03), (7.0, 0.06))
_HOW_OFTEN = (0.4, 0.4, 0.2)


class LabelledPair(NamedTuple):
    """Two clouds, their pose and their surface.

    Attributes:
        target: (N, 3).
        source: (M, 3).
        T_target_source: (4, 4), made up here.
        target_normals: (N, 3) of the surface.
        source_normals: (M, 3) of the surface.
        on_surface: (N + M,) which points of the target, then of the source, are no outliers.
        surface: (P, 3) in the target's frame.
        surface_normals: (P, 3).
    """

    target: SurfaceCloud
    source: SurfaceCloud
    T_target_source: FloatArray
    target_normals: FloatArray
    source_normals: FloatArray
    on_surface: npt.NDArray[np.bool_]
    surface: FloatArray
    surface_normals: FloatArray

    def beside(self, rng: np.random.Generator) -> FloatArray:
        """A pose (4, 4) such as the first solve leaves: near the true one."""
        degrees, shift = _BESIDE[rng.choice(len(_BESIDE), p=_HOW_OFTEN)] * np.sqrt(rng.random(2))
        E, centre = np.eye(4), self.surface.mean(axis=0)
        E[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * _direction(rng)).as_matrix()
        E[:3, 3] = centre - E[:3, :3] @ centre + shift * _direction(rng)
        return E @ self.T_target_source

    def at(self, T: FloatArray) -> LabelledCloud:
        """Both as one cloud at a pose (4, 4), the target's points first."""
        z = self.source.arrays.points @ T[:3, :3].T + T[:3, 3]
        layer = np.repeat([0, 1], [len(self.target_normals), len(self.source_normals)])
        return LabelledCloud.of(
            np.concatenate([self.target.arrays.points, z]),
            np.concatenate([self.target_normals, self.source_normals @ T[:3, :3].T]),
            self.on_surface,
            layer,
        )


def spoiling(points_per_shape: int) -> Perturbation:
    """What the clouds of a pair go through: few points, mostly noisy, cropped, with outliers."""
    most = min(_MOST, points_per_shape // 2)
    sizes = (min(_LEAST, most), most)
    return Perturbation(
        sigma=(0.004, 0.012),
        noise_probability=0.8,
        outlier_share=(0.08, 0.25),
        outlier_probability=0.75,
        crop_share=(0.1, 0.3),
        crop_probability=0.75,
        target_points=sizes,
        source_points=sizes,
    )


def labelled_pairs(sources: Sequence[ShapeSet], count: int, seed: int) -> Iterator[LabelledPair]:
    """Pairs of shapes, the sources in turn.

    Args:
        sources: of shapes.
        count: how many pairs.
        seed: of everything random.
    """
    for number in range(count):
        shapes = sources[number % len(sources)]
        shape = shapes[derived_seed(seed, Stream.TRAINING, number) % len(shapes)]
        pair = labelled_pair(shape, derived_seed(seed, Stream.PAIR, number))
        if pair is not None:
            yield pair


def labelled_pair(shape: Shape, seed: int) -> LabelledPair | None:
    """Draw two clouds of one shape, spoil and turn them; None where too few points are left."""
    shape = with_normals(shape)
    made = pair_of_shape(shape, spoiling(len(shape.points)), torch_generator(seed, Stream.PAIR))
    if min(len(made.target), len(made.source)) < _FEWEST:
        return None
    assert made.target_normals is not None
    assert made.source_normals is not None
    assert shape.normals is not None
    motion = torch_generator(seed, Stream.MOTION)
    turned, moved = (_ANY_TURN.draw(motion)[:3, :3].double().numpy() for _ in range(2))
    dense = shape.points.double().numpy()
    x, z = made.target.double().numpy(), made.source.double().numpy()
    some = np.random.default_rng(seed).choice(len(dense), min(_SEEN, len(dense)), replace=False)
    T = np.eye(4)
    T[:3, :3] = turned @ moved.T
    return LabelledPair(
        SurfaceCloud.of(x @ turned.T),
        SurfaceCloud.of(z @ moved.T),
        T,
        made.target_normals.double().numpy() @ turned.T,
        made.source_normals.double().numpy() @ moved.T,
        lie_on_surface(np.concatenate([x, z]), dense),
        dense[some] @ turned.T,
        shape.normals.double().numpy()[some] @ turned.T,
    )


def _direction(rng: np.random.Generator) -> FloatArray:
    drawn = rng.normal(size=3)
    unit: FloatArray = drawn / np.linalg.norm(drawn)
    return unit
