"""Where a figure comes from: when, on which machine, from which code, by which command."""

from __future__ import annotations

import os
import platform
import subprocess
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import torch

_CPU_INFO = Path("/proc/cpuinfo")
_PACKAGE = Path(__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class Provenance:
    """One run of a command.

    Attributes:
        date: its start, UTC.
        cpu: the processor's name.
        cores: as many as this process may use.
        threads: of PyTorch.
        load: other processes running at the start, by the load average of one minute.
        python: version.
        torch: version.
        commit: of the code, ``-dirty`` with changes that aren't committed; the package's version
            where there is no repository.
        command: that started it.
    """

    date: str
    cpu: str
    cores: int
    threads: int
    load: float
    python: str
    torch: str
    commit: str
    command: str

    @classmethod
    def now(cls, command: str) -> Provenance:
        """Describe this process."""
        return cls(
            date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M"),
            cpu=_cpu(),
            cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else _count(),
            threads=torch.get_num_threads(),
            load=round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else 0.0,
            python=platform.python_version(),
            torch=torch.__version__,
            commit=_commit(),
            command=command,
        )


def _count() -> int:
    return os.cpu_count() or 1


def _cpu() -> str:
    if _CPU_INFO.is_file():
        for line in _CPU_INFO.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _commit() -> str:
    described = subprocess.run(
        ["git", "-C", str(_PACKAGE), "describe", "--always", "--dirty", "--abbrev=12"],
        capture_output=True,
        text=True,
        check=False,
    )
    if described.returncode == 0:
        return described.stdout.strip()
    return f"equivalign {version('equivalign')}"
