"""``objects``: pairs made from shapes, by the protocols ``paper``, ``full`` and ``hard``."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import numpy as np

from benchmarks.contest import contest_progress, hold_contest
from benchmarks.contest_options import (
    add_contest_options,
    competitors_of,
    finish_contest,
    names,
)
from benchmarks.folder import make_folder
from benchmarks.pair import PairEntry
from benchmarks.protocol import PAPER_ANGLES, Protocol, ProtocolName, Sampler, build_protocol
from benchmarks.provenance import Provenance
from benchmarks.results import open_results
from benchmarks.shape_pairs import SYMMETRIC_ABOVE, ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import PROCEDURAL, ShapeCollection, Split, open_shapes
from model.exceptions import InvalidOptionError
from training.data.perturbation import CropRule


def objects_command(arguments: list[str], command: str) -> int:
    """Register shapes turned and spoilt by a protocol, with every method.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = _parser().parse_args(arguments)
    _require_an_end(given)
    collection = open_shapes(given.data, given.split, given.seed)
    protocol = _protocol(given, collection)
    results = open_results(given.out, "objects", _settings(given, protocol))
    competitors, results.absent = competitors_of(given)
    limit = None if given.limit == 0 else given.limit
    with contest_progress() as progress:
        choices = choose_shapes(collection, limit, given.symmetric, given.symmetric_above)
        entries = list_pairs(protocol, choices, given.seed)
        results.shapes = [asdict(choice) for choice in choices]
        maker = ShapePairMaker(collection, protocol)
        if given.export_pairs is not None:
            export_pairs(entries, maker, given.export_pairs)
        hold_contest(
            entries,
            maker.make,
            competitors,
            results,
            Provenance.now(command),
            given.out,
            progress,
        )
    finish_contest(results, given.out)
    return 0


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign benchmark objects", description=__doc__)
    parser.add_argument(
        "--data",
        default=PROCEDURAL,
        metavar="PLACE",
        help="archive or folder of shapes, ModelNet in any of its layouts, or procedural (default)",
    )
    parser.add_argument("--split", choices=get_args(Split), default="test")
    parser.add_argument("--protocol", choices=get_args(ProtocolName), default="paper")
    parser.add_argument("--columns", type=names, metavar="NAMES", help="default: all of them")
    parser.add_argument(
        "--angles", type=_angles, default=PAPER_ANGLES, metavar="DEG", help="for paper: 45,90"
    )
    parser.add_argument("--sampler", choices=get_args(Sampler), default="axis-angle")
    parser.add_argument("--crop", choices=get_args(CropRule), default="half_space")
    parser.add_argument(
        "--limit",
        type=int,
        default=100,
        metavar="N",
        help="asymmetric shapes at most; default 100, 0 for all",
    )
    parser.add_argument(
        "--symmetric", type=int, default=0, metavar="N", help="symmetric shapes at most; default 0"
    )
    parser.add_argument(
        "--symmetric-above",
        type=float,
        default=SYMMETRIC_ABOVE,
        metavar="SCORE",
        help=f"self-similarity after a turn of 30° or more, default {SYMMETRIC_ABOVE}",
    )
    parser.add_argument(
        "--export-pairs", type=Path, metavar="DIR", help="write every pair's clouds as NPZ here"
    )
    add_contest_options(parser)
    return parser


def _angles(text: str) -> list[float]:
    return [float(angle) for angle in text.split(",")]


def _require_an_end(given: Namespace) -> None:
    if given.data == PROCEDURAL and (given.limit == 0 or given.symmetric > 0):
        raise InvalidOptionError(
            "procedural shapes are endless, and none of them is symmetric",
            field="limit, symmetric",
            value=f"{given.limit}, {given.symmetric}",
            mend="give a limit, and no symmetric shapes",
        )


def _protocol(given: Namespace, collection: ShapeCollection) -> Protocol:
    protocol = build_protocol(
        given.protocol,
        given.angles,
        given.sampler,
        given.crop,
        collection.shapes.points_per_shape,
    )
    return protocol if given.columns is None else protocol.restricted(given.columns)


def _settings(given: Namespace, protocol: Protocol) -> dict[str, Any]:
    """What decides the pairs and their arrays, but not how many there are."""
    return {
        "data": Path(given.data).name,
        "split": given.split,
        "protocol": protocol.name,
        "sampler": given.sampler,
        "crop": given.crop,
        "seed": given.seed,
        "symmetric_above": given.symmetric_above,
    }


def export_pairs(entries: Sequence[PairEntry], maker: ShapePairMaker, folder: Path) -> None:
    """Write the clouds of every pair, without the pose, as FOLDER/COLUMN/TURN/NUMBER.npz.

    Args:
        entries: the list.
        maker: of the arrays.
        folder: made where it isn't there.

    Raises:
        UnreadableFileError: it can't be made.
    """
    for entry in entries:
        pair = maker.make(entry)
        path = folder / f"{entry.name}.npz"
        make_folder(path.parent, "export_pairs")
        np.savez(path, source=pair.source, target=pair.target, seed=entry.seed)
