"""A pair of clouds: as it was given, and in the frame it is solved in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.labels import as_labels, require_matching_labels
from model.normalization import JointFrame, extent
from model.point_cloud import as_points
from model.prepared_cloud import PreparedCloud
from model.side_by_side import side_by_side

FloatArray = npt.NDArray[np.float64]
Prepare = Callable[[FloatArray, FloatArray | None, int], PreparedCloud]

# A prepared target's unit serves for sources up to this much larger than it.
_LARGER_SOURCE = 1.25


@dataclass(frozen=True, slots=True)
class PreparedTarget:
    """A target that is encoded already; made by ``Registrar.prepare``.

    Attributes:
        points: (N, 3) as given.
        labels: (N, L), or None.
        centre: (3,) in the input's unit.
        scale: of its frame, in the input's unit.
        cloud: in its frame.
        seed: that chose its points.
    """

    points: FloatArray
    labels: FloatArray | None
    centre: FloatArray
    scale: float
    cloud: PreparedCloud
    seed: int

    @classmethod
    def of(
        cls,
        points: npt.ArrayLike,
        labels: npt.ArrayLike | None,
        prepare: Prepare,
        seed: int,
    ) -> PreparedTarget:
        """Check and prepare points (N, 3) with labels (N, L)."""
        x = as_points(points, "target")
        traits = as_labels(labels, len(x), "target_labels")
        centre = x.mean(axis=0)
        scale = extent(x - centre)
        return cls(x, traits, centre, scale, prepare((x - centre) / scale, traits, seed), seed)

    @property
    def nbytes(self) -> int:
        """Memory that it holds."""
        labels = 0 if self.labels is None else self.labels.nbytes
        return self.points.nbytes + labels + self.cloud.nbytes


@dataclass(frozen=True, slots=True)
class GivenPair:
    """What the caller gave, checked.

    Attributes:
        source: (M, 3).
        target: (N, 3).
        source_labels: (M, L), or None.
        target_labels: (N, L), or None.
        prepared: the target, where it was prepared.
    """

    source: FloatArray
    target: FloatArray
    source_labels: FloatArray | None
    target_labels: FloatArray | None
    prepared: PreparedTarget | None

    @classmethod
    def checked(
        cls,
        source: npt.ArrayLike,
        target: npt.ArrayLike | PreparedTarget,
        source_labels: npt.ArrayLike | None,
        target_labels: npt.ArrayLike | None,
    ) -> GivenPair:
        """Check both clouds and their labels.

        Raises:
            InvalidCloudError: a cloud that has no pose, or labels that don't fit.
        """
        z = as_points(source, "source")
        g = as_labels(source_labels, len(z), "source_labels")
        if isinstance(target, PreparedTarget):
            require_matching_labels(g, target.labels)
            return cls(z, target.points, g, target.labels, target)
        x = as_points(target, "target")
        f = as_labels(target_labels, len(x), "target_labels")
        require_matching_labels(g, f)
        return cls(z, x, g, f, None)


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
        frame = JointFrame.of(given.target, given.source)
        ready = given.prepared
        if ready is not None and frame.scale <= _LARGER_SOURCE * ready.scale:
            frame = JointFrame(ready.centre, frame.centre_source, ready.scale)
            source = prepare(frame.source(given.source), given.source_labels, seed)
            return cls(frame, ready.cloud, source)
        clouds = (
            (frame.target(given.target), given.target_labels),
            (frame.source(given.source), given.source_labels),
        )
        target, source = side_by_side(lambda cloud: prepare(*cloud, seed), clouds)
        return cls(frame, target, source)

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
