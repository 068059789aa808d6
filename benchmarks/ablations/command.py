"""``ablations``: the kernel, ℓ, the curriculum, the encoder, the hypotheses, the backward pass."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.ablations.recipe import CONFIGS, Workshop
from benchmarks.ablations.studies import STUDIES, Study
from benchmarks.competitor import Competitor, Contestant
from benchmarks.contest import contest_progress, hold_contest
from benchmarks.contest_options import finish_contest, names
from benchmarks.protocol import PAPER_ANGLES, Protocol, build_protocol
from benchmarks.provenance import Provenance
from benchmarks.results import open_results
from benchmarks.shape_pairs import ShapeChoice, ShapePairMaker, choose_shapes, list_pairs
from benchmarks.shapes import PROCEDURAL, ShapeCollection, open_shapes
from model.artifact import Artifact, load_artifact
from model.exceptions import InvalidOptionError, UnreadableFileError

ONE_START_COLUMNS = ("clean", "outliers")
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
    collection = open_shapes(given.data, given.split, given.seed)
    choices = choose_shapes(collection, given.limit, 0)
    shipped = load_artifact(given.artifact)
    workshop = Workshop(given.runs, given.configs, given.steps)
    out = _folder(given.out)
    for study in studies:
        _run(study, given, command, collection, choices, shipped, workshop, out)
    return 0


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


def _folder(out: Path | None) -> Path | None:
    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UnreadableFileError(
                f"the folder can't be made: {error.strerror}",
                field="out",
                value=out,
                mend="give another place",
            ) from error
    return out


def _run(
    study: Study,
    given: Namespace,
    command: str,
    collection: ShapeCollection,
    choices: Sequence[ShapeChoice],
    shipped: Artifact,
    workshop: Workshop,
    out: Path | None,
) -> None:
    settings = {
        "study": study.name,
        "question": study.question,
        "data": Path(given.data).name,
        "split": given.split,
        "seed": given.seed,
    }
    file = None if out is None else out / f"{study.name}.json"
    results = open_results(file, "ablations", settings)
    arms = study.arms(shipped, workshop)
    provenance = Provenance.now(command)
    results.shapes = [asdict(choice) for choice in choices]
    arenas: list[tuple[Protocol, list[Competitor]]] = [
        (
            build_protocol("paper", given.angles).restricted(given.one_start_columns),
            [Contestant(method) for arm in arms for method in arm.one_start],
        ),
        (
            build_protocol("hard", shape_points=collection.shapes.points_per_shape).restricted(
                given.search_columns
            ),
            [Contestant(method) for arm in arms for method in arm.search],
        ),
    ]
    with contest_progress() as progress:
        for protocol, competitors in arenas:
            if competitors:
                hold_contest(
                    list_pairs(protocol, choices, given.seed),
                    ShapePairMaker(collection, protocol).make,
                    competitors,
                    results,
                    provenance,
                    file,
                    progress,
                )
    finish_contest(results, file)
