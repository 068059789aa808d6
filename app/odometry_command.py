"""``equivalign odometry``: a folder of frames in, a trajectory out."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from app.cores import usable_cores
from app.odometry.evaluation import Evaluation
from app.odometry.options import (
    check_options,
    chosen_frames,
    framing_of,
    odometry_parser,
    outputs_of,
)
from app.odometry.run import Run
from model.exceptions import InvalidOptionError
from model.odometry import FramePreparer, Framing, Status, Step, Tracker, TrackerSettings
from model.sequence import FrameSource, open_frames

# More warnings than this are counted, not printed.
_PRINTED_WARNINGS = 20


def odometry_command(arguments: list[str]) -> int:
    """Follow a camera through a sequence of depth frames or clouds."""
    given = odometry_parser().parse_args(arguments)
    check_options(given)
    source = open_frames(given.sequence, given.max_depth, given.colour)
    numbers = chosen_frames(given, source)
    framing = framing_of(given, source)
    settings = TrackerSettings(mode=given.mode, seed=given.seed)
    run = _run(given, source, numbers, framing, settings)
    console = Console(stderr=True, highlight=False)
    evaluation = _followed(run, console)
    _require_poses(run.steps)
    _print(evaluation, as_json=given.json)
    return 0


def _run(
    given: Namespace,
    source: FrameSource,
    numbers: Sequence[int],
    framing: Framing,
    settings: TrackerSettings,
) -> Run:
    from model import Registrar

    registrar = Registrar.load(given.artifact)
    tracker = Tracker(FramePreparer(registrar, framing), settings)
    decisive: dict[str, Any] = {
        "sequence": str(given.sequence.resolve()),
        "frames": [numbers[0], numbers[-1], given.every],
        "max_depth": given.max_depth,
        "framing": asdict(framing),
        "tracker": asdict(settings),
        "artifact": registrar.summary["weights_sha256"],
        "voxel": given.voxel,
        "map": given.map is not None or given.report is not None,
    }
    return Run(source, numbers, tracker, outputs_of(given), given.voxel, given.colour, decisive)


def _followed(run: Run, console: Console) -> Evaluation:
    """Track with a progress bar; warnings are printed as they come."""
    done = run.resume()
    for note in run.source.notes:
        _warn(console, f"{run.source.name}: {note}")
    if done:
        console.print(f"Going on after {done} frames of an unfinished run.")
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[state]}"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    with progress:
        task = progress.add_task(run.source.name, total=len(run.numbers), completed=done, state="")
        teller = _Teller(run, progress, task)
        try:
            with _threads_for_two():
                evaluation = run.go(teller.tell)
        except KeyboardInterrupt:
            progress.stop()
            _tell_of_interruption(run, console)
            raise
    teller.count_unprinted()
    return evaluation


@contextmanager
def _threads_for_two() -> Iterator[None]:
    """One thread reads and encodes, one registers; more would stand in their way."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(max(1, usable_cores() // 2))
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Teller:
    """Moves the bar and prints the warnings, but not thousands of them."""

    def __init__(self, run: Run, progress: Progress, task: TaskID) -> None:
        self.run = run
        self.progress = progress
        self.task = task
        self.warnings = 0

    def tell(self, step: Step) -> None:
        """One more frame."""
        rate = self.run.tracked_here / self.run.seconds if self.run.seconds else 0.0
        state = f"{rate:.1f}/s" + (" lost" if step.status is Status.LOST else "")
        self.progress.update(self.task, advance=1, state=state)
        if not step.warning:
            return
        self.warnings += 1
        if self.warnings <= _PRINTED_WARNINGS:
            file = self.run.source.file(step.number)
            _warn(self.progress.console, f"frame {step.number} ({file}): {step.warning}")

    def count_unprinted(self) -> None:
        """At the end, say how many warnings weren't printed."""
        more = self.warnings - _PRINTED_WARNINGS
        if more > 0:
            _warn(self.progress.console, f"{more} more frames with warnings")


def _warn(console: Console, warning: str) -> None:
    console.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)


def _tell_of_interruption(run: Run, console: Console) -> None:
    if run.outputs.out is None:
        console.print("Interrupted. With --out the trajectory so far would have been kept.")
    else:
        console.print(
            f"Interrupted; {run.outputs.out} holds the {len(run.steps)} frames so far, and the "
            "same command goes on from there.",
            soft_wrap=True,
        )


def _require_poses(steps: Sequence[Step]) -> None:
    if any(step.status.has_pose for step in steps):
        return
    raise InvalidOptionError(
        "no frame of the sequence could be used",
        field="sequence",
        value=f"{len(steps)} frames; the first: {steps[0].warning}",
        mend="see the warnings",
    )


def _print(evaluation: Evaluation, *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(evaluation.as_dict(), allow_nan=False))
        return
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for subject, statement in evaluation.lines():
        table.add_row(subject, Text(statement))
    Console(highlight=False).print(table)
