"""The options of ``equivalign odometry``, checked before the long part."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from app.odometry.run import Outputs
from model.cloud_file import require_known_format
from model.exceptions import CloudFileError, InvalidOptionError
from model.odometry import MODES, DepthNoise, Framing, TrackerSettings
from model.sequence import FrameSource


def odometry_parser() -> ArgumentParser:
    """The command's arguments."""
    parser = ArgumentParser(
        prog="equivalign odometry",
        description="Follow a camera through a sequence of depth frames or clouds. The trajectory "
        "begins in the first frame's camera; measured poses in groundtruth.txt are only compared "
        "with. An interrupted run goes on with the same command.",
    )
    parser.add_argument(
        "sequence",
        type=Path,
        metavar="SEQUENCE",
        help="folder in the layout of ETH3D or TUM, or of clouds, one file a frame",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="trajectory as TUM writes it")
    parser.add_argument("--kitti", type=Path, metavar="FILE", help="trajectory as KITTI writes it")
    parser.add_argument(
        "--map", type=Path, metavar="FILE", help="fused voxel map: PLY, PCD, XYZ, NPY or NPZ"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write an HTML page here")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.add_argument(
        "--frames", type=_frames, metavar="FIRST-LAST", help="their numbers, from 0; default all"
    )
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="take every Nth; default 1"
    )
    parser.add_argument(
        "--points", type=int, default=Framing().points, help="of each frame; default 1024"
    )
    parser.add_argument(
        "--mode",
        choices=MODES,
        default=TrackerSettings().mode,
        help="register each frame to the latest keyframe (default) or to the frame before it",
    )
    parser.add_argument("--max-depth", type=float, metavar="METRES", help="leave out all beyond")
    parser.add_argument(
        "--sensor-weights",
        action="store_true",
        help="weigh points by a depth camera's noise, which grows with the depth's square",
    )
    parser.add_argument(
        "--colour", action="store_true", help="compare colours registered to depth, too"
    )
    parser.add_argument(
        "--voxel",
        type=float,
        metavar="LENGTH",
        help="edge of the map's voxels; default: a 150th of the first frame's radius",
    )
    parser.add_argument("--artifact", metavar="DIR", help="trained artifact")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    return parser


def check_options(given: Namespace) -> None:
    """Refuse what can't be done or could not be written after all the work.

    Raises:
        InvalidOptionError: a number out of its range.
        CloudFileError: no such folder, or a format that can't be written.
    """
    least = Framing().least_points
    for field, value, lowest in (
        ("every", given.every, 1),
        ("points", given.points, least),
        ("seed", given.seed, 0),
    ):
        if value < lowest:
            raise InvalidOptionError(
                "too small", field=field, value=value, mend=f"give {lowest} or more"
            )
    for field in ("max_depth", "voxel"):
        length = getattr(given, field)
        if length is not None and not 0.0 < length < float("inf"):
            raise InvalidOptionError(
                "not a positive length", field=field, value=length, mend="give metres, above 0"
            )
    if given.map is not None:
        require_known_format(given.map, "map")
    for field in ("out", "kitti", "map", "report"):
        path: Path | None = getattr(given, field)
        if path is not None and not path.parent.is_dir():
            raise CloudFileError(
                "its folder doesn't exist", field=field, value=path, mend="create the folder first"
            )


def chosen_frames(given: Namespace, source: FrameSource) -> range:
    """Numbers of the frames that are tracked.

    Raises:
        InvalidOptionError: frames that the sequence doesn't have.
    """
    chosen: range = range(len(source)) if given.frames is None else given.frames
    if len(chosen) == 0 or chosen[0] < 0 or chosen[-1] >= len(source):
        raise InvalidOptionError(
            "no such frames",
            field="frames",
            value=f"{chosen.start}-{chosen.stop - 1}",
            mend=f"{source.name} has the frames 0-{len(source) - 1}",
        )
    return chosen[:: given.every]


def framing_of(given: Namespace, source: FrameSource) -> Framing:
    """How frames become clouds.

    Raises:
        InvalidOptionError: sensor weights for a folder of clouds, whose sensor isn't known.
    """
    if given.sensor_weights and not source.is_depth:
        raise InvalidOptionError(
            "a folder of clouds doesn't tell its sensor",
            field="sensor_weights",
            mend="leave it out, or give depth images",
        )
    noise = DepthNoise() if given.sensor_weights else None
    return Framing(points=given.points, noise=noise, colour=given.colour, seed=given.seed)


def outputs_of(given: Namespace) -> Outputs:
    """Which files to write."""
    return Outputs(given.out, given.kitti, given.map, given.report)


def _frames(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)
