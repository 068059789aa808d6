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
LEFT_OUT = "symmetric, left out"
SYMMETRIC_ABOVE = 0.9


@dataclass(frozen=True, slots=True)
class ShapeChoice:
    """A shape that pairs are made of.

    Attributes:
        number: in its collection.
        name: of the shape.
        self_similarity: see training.data.symmetry.
        group: ``asymmetric``, ``symmetric``, or ``symmetric, left out``.
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

    Symmetric shapes beyond their limit that lie on the way are left out, and listed as such.

    Args:
        collection: where the shapes come from.
        limit: most asymmetric shapes; None takes all.
        symmetric_limit: most symmetric shapes; None takes all.
        symmetric_above: a greater self-similarity makes a shape symmetric.
    """
    chosen: list[ShapeChoice] = []
    for number in collection.order:
        more_asymmetric = _has_room(chosen, ASYMMETRIC, limit)
        more_symmetric = _has_room(chosen, SYMMETRIC, symmetric_limit)
        if not more_asymmetric and not more_symmetric:
            break
        shape = collection.shapes[number]
        score = self_similarity(shape.points)
        if score <= symmetric_above and not more_asymmetric:
            continue
        group = ASYMMETRIC
        if score > symmetric_above:
            group = SYMMETRIC if more_symmetric else LEFT_OUT
        chosen.append(ShapeChoice(number, shape.name, round(score, 4), group))
    return chosen


def _has_room(chosen: Sequence[ShapeChoice], group: str, limit: int | None) -> bool:
    return limit is None or sum(choice.group == group for choice in chosen) < limit


def list_pairs(protocol: Protocol, choices: Sequence[ShapeChoice], seed: int) -> list[PairEntry]:
    """One pair a shape, column and turn; none of the shapes that are left out.

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
        if choice.group != LEFT_OUT
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
