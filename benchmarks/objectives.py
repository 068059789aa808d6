"""``objectives``: which bi-level objective learns, by recall from 45° with one start."""

from __future__ import annotations

from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser, Namespace
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.objective import OBJECTIVES, Objective
from benchmarks.objective_study import CURRICULA, Study, StudySettings, plain
from benchmarks.objective_table import document, objective_sheets
from benchmarks.provenance import Provenance
from benchmarks.results import FORMAT_VERSION, read_json, require_folder, write_json
from benchmarks.table import print_sheets
from model.exceptions import InvalidOptionError

Run = tuple[str, str, int]


def objectives_command(arguments: list[str], command: str) -> int:
    """Train by each objective and measure; a file that is there already is gone on with.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = _parser().parse_args(arguments)
    require_folder(given.out)
    settings = StudySettings(str(given.shapes), steps=given.steps, test_pairs=given.pairs)
    content = _content(given.out, settings)
    console = Console()
    wanted = [run for run in _wanted(given) if run not in _done(content)]
    study = Study(settings) if wanted else None
    provenance = asdict(Provenance.now(command))
    for number, run in enumerate(wanted, start=1):
        # Another process may have added to the same file meanwhile.
        if study is None or run in _done(_content(given.out, settings)):
            continue
        name, curriculum, seed = run
        console.print(f"{number} of {len(wanted)}: {name}, {curriculum}, seed {seed}")
        answer = study.run(OBJECTIVES[name], curriculum, seed)
        row = {"objective": name, "curriculum": curriculum, "seed": seed, **answer}
        content = _content(given.out, settings)
        if run not in _done(content):
            content["rows"].append({**row, "provenance": provenance})
            write_json(given.out, content)
    print_sheets(objective_sheets(content), console)
    if given.table is not None:
        given.table.write_text(document(content))
    return 0


def _content(path: Path, settings: StudySettings) -> dict[str, Any]:
    """What the file holds, or an empty one.

    Raises:
        InvalidOptionError: it holds rows by other settings.
        UnreadableFileError: not a results file.
    """
    asked = plain(settings)
    if not path.exists():
        return {
            "format_version": FORMAT_VERSION,
            "benchmark": "objectives",
            "settings": asked,
            "rows": [],
        }
    content = read_json(path)
    kept = content.get("settings", {})
    other = [name for name in asked if kept.get(name) != asked[name]]
    if content.get("benchmark") != "objectives" or other:
        raise InvalidOptionError(
            "this file holds rows by other settings",
            field="out",
            value=", ".join(f"{name} {kept.get(name)}" for name in other) or path,
            mend="give another file, or the same settings",
        )
    return content


def _wanted(given: Namespace) -> list[Run]:
    """Seed by seed, so that a table that isn't complete has fewer seeds, not fewer rows."""
    unknown = [name for name in given.only or () if name not in OBJECTIVES]
    if unknown:
        raise InvalidOptionError(
            "no such objective",
            field="only",
            value=", ".join(unknown),
            mend=f"choose among {'; '.join(OBJECTIVES)}",
        )
    chosen = [OBJECTIVES[name] for name in given.only or OBJECTIVES]
    return [
        (objective.name, curriculum, seed)
        for seed in given.seeds
        for objective in chosen
        for curriculum in _curricula(objective, given.angles)
    ]


def _curricula(objective: Objective, chosen: list[str]) -> list[str]:
    """What doesn't train has no curriculum."""
    return chosen if objective.encoder == "trained" else ["direct"]


def _done(content: dict[str, Any]) -> set[Run]:
    return {(row["objective"], row["curriculum"], row["seed"]) for row in content["rows"]}


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="equivalign benchmark objectives",
        description=f"{__doc__} Stop it at any time; run again, it goes on.",
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    defaults = StudySettings("")
    parser.add_argument("shapes", type=Path, metavar="SHAPES.npz", help="packed shapes")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="results as JSON")
    parser.add_argument("--table", type=Path, metavar="FILE", help="the table as Markdown")
    parser.add_argument("--steps", type=int, default=defaults.steps, help="outer steps a training")
    parser.add_argument("--pairs", type=int, default=defaults.test_pairs, help="test pairs")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], metavar="SEED")
    parser.add_argument(
        "--angles", nargs="+", choices=list(CURRICULA), default=list(CURRICULA), help="of trainings"
    )
    parser.add_argument(
        "--only", action="append", metavar="NAME", help="this objective; may be given again"
    )
    return parser
