"""A pair of clouds: as it was given, and in the frame it is solved in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.labels import as_labels, as_weights, require_matching_labels
from model.normalization import JointFrame, as_unit, extent
from model.point_cloud import as_points
from model.prepared_cloud import PreparedCloud
from model.side_by_side import side_by_side

FloatArray = npt.NDArray[np.float64]
Prepare = Callable[[FloatArray, FloatArray | None, FloatArray | None, int], PreparedCloud]

# A prepared target's unit serves for sources up to this much larger than it.
_LARGER_SOURCE = 1.25


@dataclass(frozen=True, slots=True)
class PreparedTarget:
    """A target that is encoded already; made by ``Registrar.prepare``.

    It also serves as the source of another that was prepared in the same unit.

    Attributes:
        points: (N, 3) as given.
        labels: (N, L), or None.
        centre: (3,) in the input's unit.
        scale: of its frame, in the input's unit.
        cloud: in its frame.
        seed: that chose its points.
        weights: (N,) what each point counts, or None where all count 1.
    """

    points: FloatArray
    labels: FloatArray | None
    centre: FloatArray
    scale: float
    cloud: PreparedCloud
    seed: int
    weights: FloatArray | None = None

    @classmethod
    def of(
        cls,
        points: npt.ArrayLike,
        labels: npt.ArrayLike | None,
        prepare: Prepare,
        seed: int,
        weights: npt.ArrayLike | None = None,
        unit: float | None = None,
    ) -> PreparedTarget:
        """Check and prepare points (N, 3) with labels (N, L) and weights (N,)."""
        x = as_points(points, "target")
        traits = as_labels(labels, len(x), "target_labels")
        centre = x.mean(axis=0)
        counts = as_weights(weights, len(x), "target_weights")
        scale = extent(x - centre) if unit is None else as_unit(unit)
        cloud = prepare((x - centre) / scale, traits, counts, seed)
        cloud.get_ready()
        return cls(x, traits, centre, scale, cloud, seed, counts)

    @property
    def nbytes(self) -> int:
        """Memory that it holds."""
        given = (self.points, self.labels, self.weights)
        return sum(a.nbytes for a in given if a is not None) + self.cloud.nbytes

    def forget(self) -> None:
        """Give back the memory of what is made again when it is asked for."""
        self.cloud.forget()


@dataclass(frozen=True, slots=True)
class GivenPair:
    """What the caller gave, checked.

    Attributes:
        source: (M, 3).
        target: (N, 3).
        source_labels: (M, L), or None.
        target_labels: (N, L), or None.
        prepared: the target, where it was prepared.
        prepared_source: the source, where it was prepared.
    """

    source: FloatArray
    target: FloatArray
    source_labels: FloatArray | None
    target_labels: FloatArray | None
    prepared: PreparedTarget | None
    prepared_source: PreparedTarget | None = None

    @classmethod
    def checked(
        cls,
        source: npt.ArrayLike | PreparedTarget,
        target: npt.ArrayLike | PreparedTarget,
        source_labels: npt.ArrayLike | None,
        target_labels: npt.ArrayLike | None,
    ) -> GivenPair:
        """Check both clouds and their labels.

        Raises:
            InvalidCloudError: a cloud that has no pose, or labels that don't fit.
        """
        z, g, source_ready = _checked(source, source_labels, "source")
        x, f, target_ready = _checked(target, target_labels, "target")
        require_matching_labels(g, f)
        return cls(z, x, g, f, target_ready, source_ready)

    @property
    def source_cloud(self) -> tuple[FloatArray | None, FloatArray | None]:
        """The source's labels and weights."""
        return self.source_labels, _weights_of(self.prepared_source)

    @property
    def target_cloud(self) -> tuple[FloatArray | None, FloatArray | None]:
        """The target's labels and weights."""
        return self.target_labels, _weights_of(self.prepared)


@dataclass(frozen=True, slots=True)
class Pair:
    """Both clouds in the frame they are solved in.

    Attributes:
        frame: back to the input's unit.
        target: encoded.
        source: encoded.
    """

    frame: JointFrame
    target: PreparedCloud
    source: PreparedCloud

    @classmethod
    def of(cls, given: GivenPair, prepare: Prepare, seed: int) -> Pair:
        """Centre each cloud, divide both by one scale, prepare them."""
        ready, moving = given.prepared, given.prepared_source
        if ready is not None and moving is not None and ready.scale == moving.scale:
            frame = JointFrame(ready.centre, moving.centre, ready.scale)
            return cls(frame, ready.cloud, moving.cloud)
        frame = JointFrame.of(given.target, given.source)
        if ready is not None and frame.scale <= _LARGER_SOURCE * ready.scale:
            frame = JointFrame(ready.centre, frame.centre_source, ready.scale)
            source = prepare(frame.source(given.source), *given.source_cloud, seed)
            return cls(frame, ready.cloud, source)
        clouds = (
            (frame.target(given.target), *given.target_cloud),
            (frame.source(given.source), *given.source_cloud),
        )
        target, source = side_by_side(lambda cloud: prepare(*cloud, seed), clouds)
        return cls(frame, target, source)

    def wait(self) -> None:
        """Until the features of both clouds are there."""
        for cloud in (self.source, self.target):
            cloud.encoding.help()
        for cloud in (self.source, self.target):
            cloud.encoding()

    @property
    def spacing(self) -> float:
        """Of the sparser of the clouds of the last stage."""
        return max(self.target.dense.spacing, self.source.dense.spacing)

    @property
    def sparse_spacing(self) -> float:
        """Of the sparser of the clouds of the search."""
        return max(self.target.sparse.spacing, self.source.sparse.spacing)

    @property
    def notes(self) -> list[str]:
        """How the clouds were reduced, in words."""
        clouds = (("target", self.target), ("source", self.source))
        return [f"{name}: {cloud.note}" for name, cloud in clouds if cloud.note]

    def initial(self, T: FloatArray | None) -> Tensor | None:
        """The caller's guess (4, 4) in the frame."""
        return None if T is None else torch.from_numpy(self.frame.pose_in(T))


def _checked(
    cloud: npt.ArrayLike | PreparedTarget, labels: npt.ArrayLike | None, field: str
) -> tuple[FloatArray, FloatArray | None, PreparedTarget | None]:
    """Points, labels, and the cloud itself where it is prepared; that has labels of its own."""
    if isinstance(cloud, PreparedTarget):
        return cloud.points, cloud.labels, cloud
    points = as_points(cloud, field)
    return points, as_labels(labels, len(points), f"{field}_labels"), None


def _weights_of(ready: PreparedTarget | None) -> FloatArray | None:
    return None if ready is None else ready.weights
