"""Options that the benchmarks on depth frames share: which sequences, which of their frames."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

from model.exceptions import InvalidOptionError


def add_sequence_options(parser: ArgumentParser) -> None:
    """Add --sequence and --frames."""
    parser.add_argument(
        "--sequence",
        type=Path,
        nargs="+",
        required=True,
        metavar="DIR",
        help="in the layout of ETH3D or TUM, with groundtruth.txt, or a folder of such folders",
    )
    parser.add_argument(
        "--frames",
        type=frame_range,
        metavar="FIRST-LAST",
        help="default: all whose poses are known",
    )


def sequence_folders(given: Sequence[Path]) -> list[Path]:
    """Each folder of a sequence, and the sequences in each other folder.

    Args:
        given: folders.

    Raises:
        InvalidOptionError: two sequences have one name.
    """
    folders = [found for root in given for found in _sequences_in(root)]
    named = [folder.name for folder in folders]
    if len(set(named)) < len(named):
        raise InvalidOptionError(
            "two sequences have one name",
            field="sequence",
            value=", ".join(sorted({name for name in named if named.count(name) > 1})),
            mend="give each once, in folders of different names",
        )
    return folders


def _sequences_in(root: Path) -> list[Path]:
    inside = sorted(path.parent for path in root.glob("*/calibration.txt"))
    alone = (root / "calibration.txt").is_file() or not inside
    return [root] if alone else inside


def frame_range(text: str) -> range:
    """``FIRST-LAST`` as numbers, both included."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def gap_list(text: str) -> list[int]:
    """Numbers with commas between."""
    return [int(gap) for gap in text.split(",")]
