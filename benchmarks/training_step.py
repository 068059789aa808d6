"""``training``: pairs a second of a configuration's training step, and where the time goes."""

from __future__ import annotations

import time
from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser
from collections.abc import Iterator
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from statistics import mean, median

import torch
from rich.console import Console

from benchmarks.markdown import markdown
from benchmarks.provenance import Provenance
from benchmarks.results import FORMAT_VERSION, require_folder, write_json
from benchmarks.sheet import Sheet
from benchmarks.table import print_sheets
from model.exceptions import InvalidOptionError
from training.cli import build
from training.data.pairs import PairBatch
from training.frame import in_joint_frame
from training.module import EquivAlign

PARTS = ("data", "encode", "inner", "outer")
# The first steps start the workers and fill caches.
_WARM_UP = 3


def training_command(arguments: list[str], command: str) -> int:
    """Time single steps; what follows ``--`` goes to the configuration, as for ``fit``.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    parser = _parser()
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    given, overrides = parser.parse_args(arguments[:cut]), arguments[cut + 1 :]
    if given.steps < 1:
        raise InvalidOptionError(
            "no step to time", field="steps", value=given.steps, mend="give 1 or more"
        )
    if given.out is not None:
        require_folder(given.out)
    provenance = Provenance.now(command)
    torch.set_num_threads(given.threads)
    model, data = build(["-c", str(given.config), *overrides])
    # The hardest stage; its angle changes what the inner loop has to do, not what it costs.
    data.max_angle = model.curriculum.stages[-1].max_angle
    seconds = time_steps(model, iter(data.train_dataloader()), given.steps)
    sheet = step_sheet(seconds, data.batch_size, f"{given.config.name}, {given.threads} threads")
    print_sheets([sheet], Console())
    if given.table is not None:
        given.table.write_text(f"{markdown(sheet)}\n- `{command}`\n")
    if given.out is not None:
        content = {
            "format_version": FORMAT_VERSION,
            "benchmark": "training",
            "settings": {
                "config": given.config.name,
                "overrides": overrides,
                "threads": given.threads,
                "batch_size": data.batch_size,
            },
            "provenance": asdict(provenance),
            "seconds": seconds,
        }
        write_json(given.out, content)
    return 0


def time_steps(
    model: EquivAlign, batches: Iterator[PairBatch], steps: int
) -> list[dict[str, float]]:
    """Seconds of each part of each step, on the CPU.

    ``data`` is what the step waits for; workers go on meanwhile. ``outer`` holds the losses, the
    whole backward pass (through the encoder, too) and the optimiser.
    """
    rate = model.curriculum.stage.learning_rate
    optimizer = torch.optim.AdamW(model.parameters(), lr=rate, weight_decay=model.weight_decay)
    measured = []
    for _ in range(steps + _WARM_UP):
        marks = [time.perf_counter()]
        batch = in_joint_frame(next(batches))
        marks.append(time.perf_counter())
        target, source = model.encode(batch)
        marks.append(time.perf_counter())
        solution = model.solve(target, source, batch)
        marks.append(time.perf_counter())
        loss, _ = model.outer_loss(model.alignment(batch, target, source, solution))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        marks.append(time.perf_counter())
        times = [after - before for before, after in pairwise(marks)]
        measured.append(dict(zip(PARTS, times, strict=True)))
    return measured[_WARM_UP:]


def step_sheet(seconds: list[dict[str, float]], batch_size: int, title: str) -> Sheet:
    """Means of the parts, their shares, and pairs a second."""
    totals = [sum(step.values()) for step in seconds]
    whole = mean(totals)
    rows = []
    for part in PARTS:
        spent = mean(step[part] for step in seconds)
        rows.append([part, f"{1000 * spent:.1f}", f"{100 * spent / whole:.1f} %"])
    rows.append(["step", f"{1000 * whole:.1f}", "100 %"])
    note = (
        f"{batch_size / whole:.2f} pairs/s on average, {batch_size / median(totals):.2f} by the "
        f"median step; {len(seconds)} steps of {batch_size} pairs. data: waiting for the workers; "
        "outer: losses, the whole backward pass, optimiser."
    )
    return Sheet(f"A training step, {title}", ["part", "ms", "share"], rows, 1, note)


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="equivalign benchmark training",
        description=__doc__,
        epilog="Options of the configuration follow after --, as for fit.",
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("config", type=Path, metavar="CONFIG.yaml", help="as for fit")
    parser.add_argument("--steps", type=int, default=40, help="steps that count")
    parser.add_argument("--threads", type=int, default=2, help="of PyTorch")
    parser.add_argument("--out", type=Path, metavar="FILE", help="results as JSON")
    parser.add_argument("--table", type=Path, metavar="FILE", help="the table as Markdown")
    return parser
