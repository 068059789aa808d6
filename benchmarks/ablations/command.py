"""``ablations``: the kernel, ℓ, the curriculum, the encoder, the hypotheses, the backward pass."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.ablations.arm import Arm
from benchmarks.ablations.recipe import CONFIGS, Workshop
from benchmarks.ablations.studies import STUDIES, Study
from benchmarks.competitor import Competitor, Contestant
from benchmarks.contest import contest_progress, hold_contest
from benchmarks.contest_options import finish_contest, names
from benchmarks.folder import make_folder
from benchmarks.protocol import PAPER_ANGLES, Protocol, build_protocol
from benchmarks.provenance import Provenance
from benchmarks.results import Results, open_results
from benchmarks.shape_pairs import ShapeChoice, ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import PROCEDURAL, ShapeCollection, open_shapes
from model.artifact import load_artifact
from model.exceptions import InvalidOptionError

ONE_START_COLUMNS = ("clean", "crop20")
SEARCH_COLUMNS = ("noisy", "all")


def ablations_command(arguments: list[str], command: str) -> int:
    """Change one thing at a time; rows that need a training of their own get it, in minutes.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results files.
    """
    given = _parser().parse_args(arguments)
    studies = _studies(given.studies)
    if given.limit < 1:
        raise InvalidOptionError(
            "not a number of shapes", field="limit", value=given.limit, mend="give 1 or more"
        )
    grounds = Grounds.of(given)
    shipped = load_artifact(given.artifact)
    workshop = Workshop(given.runs, given.configs, given.steps)
    out = None if given.out is None else make_folder(given.out, "out")
    for study in studies:
        file = None if out is None else out / f"{study.name}.json"
        results = open_results(file, "ablations", _settings(given, study))
        results.shapes = [asdict(choice) for choice in grounds.choices]
        grounds.measure(study.arms(shipped, workshop), results, Provenance.now(command), file)
        finish_contest(results, file)
    return 0


@dataclass(frozen=True, slots=True)
class Grounds:
    """The pairs of all studies.

    Attributes:
        collection: of shapes.
        choices: those that pairs are made of.
        one_start: the protocol of methods without a search.
        search: the protocol of whole methods.
        seed: of the pairs.
    """

    collection: ShapeCollection
    choices: Sequence[ShapeChoice]
    one_start: Protocol
    search: Protocol
    seed: int

    @classmethod
    def of(cls, given: Namespace) -> Grounds:
        """As the options ask."""
        collection = open_shapes(given.data, given.split, given.seed)
        points = collection.shapes.points_per_shape
        return cls(
            collection,
            choose_shapes(collection, given.limit, 0),
            build_protocol("paper", given.angles, shape_points=points).restricted(
                given.one_start_columns
            ),
            build_protocol("hard", shape_points=points).restricted(given.search_columns),
            given.seed,
        )

    def measure(
        self, arms: Sequence[Arm], results: Results, provenance: Provenance, file: Path | None
    ) -> None:
        """Fill in the rows that are missing: one start first, then the search."""
        contests: list[tuple[Protocol, list[Competitor]]] = [
            (self.one_start, [Contestant(method) for arm in arms for method in arm.one_start]),
            (self.search, [Contestant(method) for arm in arms for method in arm.search]),
        ]
        with contest_progress() as progress:
            for protocol, competitors in contests:
                if competitors:
                    hold_contest(
                        list_pairs(protocol, self.choices, self.seed),
                        ShapePairMaker(self.collection, protocol).make,
                        competitors,
                        results,
                        provenance,
                        file,
                        progress,
                    )


def _settings(given: Namespace, study: Study) -> dict[str, Any]:
    return {
        "study": study.name,
        "question": study.question,
        "data": Path(given.data).name,
        "split": given.split,
        "seed": given.seed,
    }


def _parser() -> ArgumentParser:
    parser = ArgumentParser(prog="equivalign benchmark ablations", description=__doc__)
    parser.add_argument(
        "--studies",
        type=names,
        default=list(STUDIES),
        metavar="NAMES",
        help="; ".join(f"{study.name}: {study.question}" for study in STUDIES.values()),
    )
    parser.add_argument("--data", default=PROCEDURAL, metavar="PLACE", help="as for objects")
    parser.add_argument("--split", default="test")
    parser.add_argument(
        "--limit", type=int, default=20, metavar="N", help="asymmetric shapes, default 20"
    )
    parser.add_argument(
        "--angles",
        type=lambda text: [float(angle) for angle in text.split(",")],
        default=list(PAPER_ANGLES),
        metavar="DEG,…",
        help="of the pairs for one start, default 45,90",
    )
    parser.add_argument(
        "--one-start-columns",
        type=names,
        default=list(ONE_START_COLUMNS),
        metavar="NAMES",
        help=f"of the protocol paper, default {','.join(ONE_START_COLUMNS)}",
    )
    parser.add_argument(
        "--search-columns",
        type=names,
        default=list(SEARCH_COLUMNS),
        metavar="NAMES",
        help=f"of the protocol hard, default {','.join(SEARCH_COLUMNS)}",
    )
    parser.add_argument("--artifact", metavar="DIR", help="where no training is asked for")
    parser.add_argument(
        "--configs", type=Path, default=CONFIGS, metavar="DIR", help="default configs/ablations"
    )
    parser.add_argument(
        "--runs",
        type=Path,
        default=Path("runs/ablations"),
        metavar="DIR",
        help="keeps the trainings, default runs/ablations",
    )
    parser.add_argument(
        "--steps", type=int, metavar="N", help="of each training, instead of the configurations'"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="a results file a study, plots beside it; resumes"
    )
    return parser


def _studies(wanted: Sequence[str]) -> list[Study]:
    unknown = [name for name in wanted if name not in STUDIES]
    if unknown or not wanted:
        raise InvalidOptionError(
            "no such study",
            field="studies",
            value=", ".join(unknown),
            mend=f"choose from {', '.join(STUDIES)}",
        )
    return [STUDIES[name] for name in wanted]
