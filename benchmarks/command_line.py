"""``equivalign benchmark NAME …`` and ``python -m benchmarks NAME …``."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from importlib import import_module

# name: (module, function, summary). Imported only when asked for: each brings its own libraries.
_BENCHMARKS = {
    "objects": ("benchmarks.objects", "objects_command", "shapes, turned and spoilt by a protocol"),
    "rgbd": ("benchmarks.rgbd", "rgbd_command", "real depth frames of a sequence"),
    "odometry": (
        "benchmarks.odometry.command",
        "odometry_command",
        "trajectories through depth frames",
    ),
    "ablations": (
        "benchmarks.ablations.command",
        "ablations_command",
        "one thing changed at a time",
    ),
    "speed": ("benchmarks.speed", "speed_command", "time, stages, growth and memory"),
    "objectives": (
        "benchmarks.objectives",
        "objectives_command",
        "which bi-level objective learns",
    ),
    "training": ("benchmarks.training_step", "training_command", "pairs a second of a training"),
    "check": ("benchmarks.self_check", "check_command", "that the scoring has teeth"),
    "service": ("benchmarks.service", "service_command", "HTTP's share, load, a stop in mid-load"),
    "scaling": ("benchmarks.scaling", "scaling_command", "a batch on one worker and on several"),
    "report": ("benchmarks.report", "report_command", "Markdown from results files"),
}


def benchmark_command(argv: list[str]) -> int:
    """Compare methods on the same arrays in the same run.

    Args:
        argv: the benchmark's name and its arguments.

    Returns:
        The exit code.

    Raises:
        EquivAlignError: naming the option or the file that is wrong, and the mend.
    """
    name, *arguments = argv or ["--help"]
    if name in ("-h", "--help"):
        sys.stdout.write(_overview())
        return 0
    if name not in _BENCHMARKS:
        sys.stderr.write(f"unknown benchmark {name!r}; there are {', '.join(_BENCHMARKS)}\n")
        return 2
    module, function, _ = _BENCHMARKS[name]
    run: Callable[[list[str], str], int] = getattr(import_module(module), function)
    return run(arguments, f"python -m benchmarks {shlex.join(argv)}")


def _overview() -> str:
    width = max(map(len, _BENCHMARKS))
    lines = [f"  {name:<{width}}  {summary}" for name, (_, _, summary) in _BENCHMARKS.items()]
    return "\n".join(
        [
            "usage: equivalign benchmark NAME [ARGUMENTS …]",
            "",
            *lines,
            "",
            "equivalign benchmark NAME --help tells more.",
            "",
        ]
    )
