"""Pairs of clouds: sampled from a shape, perturbed, moved apart and put into batches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence
from torch.utils.data import Dataset

from model.exceptions import InvalidOptionError
from model.se3 import inverse
from training.data.perturbation import Perturbation, perturbed
from training.data.seeding import Stream, torch_generator
from training.data.shape import Shape, ShapeSet


class PairKey(NamedTuple):
    """Names a pair: everything random about it follows from this and the seed."""

    epoch: int
    number: int


class RegistrationPair(NamedTuple):
    """Two clouds and the pose between them.

    Attributes:
        target: (N, 3) float32.
        source: (M, 3) float32.
        T_target_source: (4, 4) float32; exact for made pairs, measured for real ones.
        is_synthetic: whether the pose was made up here. Losses may then use it; the pose of a real
            pair is for metrics only.
        name: what the pair is called in lists and messages.
        number: the pair's place in its epoch.
        target_normals: (N, 3), or None where unknown.
        source_normals: (M, 3), or None where unknown.
        target_labels: (N, L) l(x) of the paper, which no motion changes, or None for l = 1.
        source_labels: (M, L), or None.
    """

    target: Tensor
    source: Tensor
    T_target_source: Tensor
    is_synthetic: bool
    name: str
    number: int
    target_normals: Tensor | None = None
    source_normals: Tensor | None = None
    target_labels: Tensor | None = None
    source_labels: Tensor | None = None

    def moved(self, T: Tensor) -> RegistrationPair:
        """See the source in another frame: its old coordinates are T (4, 4) times its new ones."""
        normals = self.source_normals
        return self._replace(
            source=(self.source - T[:3, 3]) @ T[:3, :3],
            source_normals=None if normals is None else normals @ T[:3, :3],
            T_target_source=self.T_target_source @ T,
        )


class PairBatch(NamedTuple):
    """Pairs padded to common lengths.

    Attributes:
        target: (B, N, 3) float32, zero where padded.
        source: (B, M, 3) float32, zero where padded.
        target_mask: (B, N) float32, 1 for a point and 0 for padding.
        source_mask: (B, M) float32.
        T_target_source: (B, 4, 4) float32.
        is_synthetic: (B,) bool.
        number: (B,) int64, the pairs' places in their epoch.
        names: B names.
        target_labels: (B, N, L), zero where padded, or None for l = 1.
        source_labels: (B, M, L), or None.
    """

    target: Tensor
    source: Tensor
    target_mask: Tensor
    source_mask: Tensor
    T_target_source: Tensor
    is_synthetic: Tensor
    number: Tensor
    names: list[str]
    target_labels: Tensor | None = None
    source_labels: Tensor | None = None

    def moved(self, T: Tensor) -> PairBatch:
        """See every source in another frame: its old coordinates are T (B, 4, 4) times its new."""
        shifted = self.source - T[:, None, :3, 3]
        return self._replace(
            source=(shifted @ T[:, :3, :3]) * self.source_mask[..., None],
            T_target_source=self.T_target_source @ T,
        )

    def swapped(self) -> PairBatch:
        """Target and source exchanged."""
        return self._replace(
            target=self.source,
            source=self.target,
            target_mask=self.source_mask,
            source_mask=self.target_mask,
            target_labels=self.source_labels,
            source_labels=self.target_labels,
            T_target_source=inverse(self.T_target_source),
        )


def collate(pairs: Sequence[RegistrationPair]) -> PairBatch:
    """Pad pairs of any lengths into one batch; normals stay behind."""
    target, target_mask = _padded([pair.target for pair in pairs])
    source, source_mask = _padded([pair.source for pair in pairs])
    return PairBatch(
        target,
        source,
        target_mask,
        source_mask,
        torch.stack([pair.T_target_source for pair in pairs]),
        torch.tensor([pair.is_synthetic for pair in pairs]),
        torch.tensor([pair.number for pair in pairs]),
        [pair.name for pair in pairs],
        _labels([pair.target_labels for pair in pairs]),
        _labels([pair.source_labels for pair in pairs]),
    )


def _labels(labels: Sequence[Tensor | None]) -> Tensor | None:
    known = [one for one in labels if one is not None]
    return _padded(known)[0] if len(known) == len(labels) else None


def _padded(clouds: list[Tensor]) -> tuple[Tensor, Tensor]:
    points = pad_sequence(clouds, batch_first=True)
    length = torch.tensor([len(cloud) for cloud in clouds])
    mask = torch.arange(points.shape[1]) < length[:, None]
    return points, mask.float()


class PairSource(Protocol):
    """Pairs by key, before the random motion; every key gives the same pair every time."""

    def __len__(self) -> int:
        """Pairs in an epoch."""
        ...

    def __getitem__(self, key: PairKey) -> RegistrationPair: ...


class ShapePairs(Dataset[RegistrationPair]):
    """Pairs made from shapes: two samples of one shape, each perturbed, in one frame.

    Epochs go on through the shapes where the last one stopped, each time through in another order.

    Args:
        shapes: where the samples come from.
        perturbation: what happens to each.
        pairs_per_epoch: length of an epoch, whatever the number of shapes.
        seed: non-negative.
        stream: keeps training, validation and test apart under one seed.
        shuffle: whether to reorder the shapes on every pass.

    Raises:
        InvalidOptionError: the shapes have too few points for the clouds that are asked for.
    """

    def __init__(
        self,
        shapes: ShapeSet,
        perturbation: Perturbation,
        pairs_per_epoch: int,
        seed: int,
        stream: Stream,
        shuffle: bool = True,
    ) -> None:
        _require_points(shapes.points_per_shape, perturbation)
        self.shapes = shapes
        self.perturbation = perturbation
        self.pairs_per_epoch = pairs_per_epoch
        self.seed = seed
        self.stream = stream
        self.shuffle = shuffle
        self._pass = -1
        self._order: Tensor | None = None

    def __len__(self) -> int:
        return self.pairs_per_epoch

    def __getitem__(self, key: PairKey) -> RegistrationPair:
        """The pair, with T_target_source the identity."""
        shape = self.shapes[self._shape_number(key.epoch * self.pairs_per_epoch + key.number)]
        generator = torch_generator(self.seed, self.stream, Stream.PAIR, *key)
        return pair_of_shape(shape, self.perturbation, generator, key.number)

    def _shape_number(self, count: int) -> int:
        """The shape of the count-th pair since the beginning of the training."""
        through, place = divmod(count, len(self.shapes))
        if not self.shuffle:
            return place
        if through != self._pass or self._order is None:
            generator = torch_generator(self.seed, self.stream, Stream.ORDER, through)
            self._order = torch.randperm(len(self.shapes), generator=generator)
            self._pass = through
        return int(self._order[place])


def _require_points(available: int, perturbation: Perturbation) -> None:
    needed = perturbation.points_needed
    if needed > available:
        raise InvalidOptionError(
            f"a pair needs up to {needed} points of a shape; these have {available}",
            field="perturbation.target_points, perturbation.source_points",
            value=[list(perturbation.target_points), list(perturbation.source_points)],
            mend="ask for fewer points, or set resample_probability to 0 so that clouds share them",
        )


def pair_of_shape(
    shape: Shape, perturbation: Perturbation, generator: torch.Generator, number: int = 0
) -> RegistrationPair:
    """Sample and perturb both clouds of a pair, still in one frame.

    Args:
        shape: P points, at least ``perturbation.points_needed``.
        perturbation: ranges of everything that may happen.
        generator: source of the draws.
        number: the pair's place in its epoch.
    """
    n = _drawn_count(perturbation.target_points, generator)
    m = _drawn_count(perturbation.source_points, generator)
    order = torch.randperm(len(shape.points), generator=generator)
    if bool(torch.rand((), generator=generator) < perturbation.resample_probability):
        chosen = order[:n], order[n : n + m]
    else:
        chosen = order[:n], order[:m][torch.randperm(m, generator=generator)]
    clouds = [
        perturbed(
            shape.points[rows],
            None if shape.normals is None else shape.normals[rows],
            perturbation,
            generator,
        )
        for rows in chosen
    ]
    (target, target_normals), (source, source_normals) = clouds
    identity = torch.eye(4)
    return RegistrationPair(
        target, source, identity, True, shape.name, number, target_normals, source_normals
    )


def _drawn_count(limits: tuple[int, int], generator: torch.Generator) -> int:
    low, high = limits
    return int(torch.randint(low, high + 1, (1,), generator=generator))
