"""Pairs of one shape each, by a protocol."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.pair import BenchmarkPair, PairEntry, orthonormal
from benchmarks.protocol import Protocol
from benchmarks.shapes import ShapeCollection
from training.data.pairs import pair_of_shape
from training.data.seeding import Stream, derived_seed, torch_generator
from training.data.symmetry import self_similarity

ASYMMETRIC = "asymmetric"
SYMMETRIC = "symmetric"
SYMMETRIC_ABOVE = 0.9


@dataclass(frozen=True, slots=True)
class ShapeChoice:
    """A shape that pairs are made of.

    Attributes:
        number: in its collection.
        name: of the shape.
        self_similarity: see training.data.symmetry.
        group: ``asymmetric`` or ``symmetric``.
    """

    number: int
    name: str
    self_similarity: float
    group: str


def choose_shapes(
    collection: ShapeCollection,
    limit: int | None,
    symmetric_limit: int | None,
    symmetric_above: float = SYMMETRIC_ABOVE,
) -> list[ShapeChoice]:
    """Go through the shapes in their order until both groups are full.

    Once the asymmetric group is full, the search for symmetric ones goes on only if they are
    wanted; symmetric shapes beyond their limit are passed over.

    Args:
        collection: where the shapes come from.
        limit: most asymmetric shapes; None takes all.
        symmetric_limit: most symmetric shapes; None takes all.
        symmetric_above: a greater self-similarity makes a shape symmetric.
    """
    limits = {ASYMMETRIC: limit, SYMMETRIC: symmetric_limit}
    chosen: list[ShapeChoice] = []
    for number in collection.order:
        wanted = [group for group in limits if _has_room(chosen, group, limits[group])]
        if not wanted:
            break
        shape = collection.shapes[number]
        score = self_similarity(shape.points)
        group = SYMMETRIC if score > symmetric_above else ASYMMETRIC
        if group in wanted:
            chosen.append(ShapeChoice(number, shape.name, round(score, 4), group))
    return chosen


def _has_room(chosen: Sequence[ShapeChoice], group: str, limit: int | None) -> bool:
    return limit is None or sum(choice.group == group for choice in chosen) < limit


def list_pairs(protocol: Protocol, choices: Sequence[ShapeChoice], seed: int) -> list[PairEntry]:
    """One pair a shape, column and turn.

    Shapes come first, so that a run that is interrupted has measured all columns of some shapes.
    A shape's pairs share one seed: its columns then differ in what is done to the points only.
    """
    return [
        PairEntry(
            name=f"{column.name}/{turn.name}/{choice.number:05d}",
            column=column.name,
            turn=turn.name,
            subject=choice.number,
            subject_name=choice.name,
            group=choice.group,
            # Some methods take seeds of 31 bits only.
            seed=derived_seed(seed, Stream.TEST, choice.number) % 2**31,
        )
        for choice in choices
        for turn in protocol.turns
        for column in protocol.columns
    ]


@dataclass(frozen=True, slots=True)
class ShapePairMaker:
    """Makes the arrays of a listed pair.

    Attributes:
        collection: the shapes.
        protocol: the columns and turns.
    """

    collection: ShapeCollection
    protocol: Protocol

    def make(self, entry: PairEntry) -> BenchmarkPair:
        """The same arrays for the same entry, in float64."""
        shape = self.collection[entry.subject]
        column = next(c for c in self.protocol.columns if c.name == entry.column)
        turn = next(t for t in self.protocol.turns if t.name == entry.turn)
        samples = torch_generator(entry.seed, Stream.PAIR)
        still = pair_of_shape(shape, column.perturbation, samples)
        T = orthonormal(turn.motion.draw(torch_generator(entry.seed, Stream.MOTION)))
        exact = still._replace(
            target=still.target.double(),
            source=still.source.double(),
            T_target_source=still.T_target_source.double(),
            source_normals=None,
        )
        moved = exact.moved(T)
        return BenchmarkPair(
            entry,
            moved.source.numpy(),
            moved.target.numpy(),
            moved.T_target_source.numpy(),
            shape.points.double().numpy(),
        )
