"""``python -m benchmarks``."""

from __future__ import annotations

import sys

from benchmarks.command_line import benchmark_command
from model.exceptions import EquivAlignError

if __name__ == "__main__":
    try:
        sys.exit(benchmark_command(sys.argv[1:]))
    except EquivAlignError as error:
        sys.stderr.write(f"benchmarks: {error}\n")
        sys.exit(2)
