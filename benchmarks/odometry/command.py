"""``odometry``: trajectories through depth frames, and pairs of frames that were turned away."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.contest import contest_progress
from benchmarks.frame_pairs import list_frame_pairs
from benchmarks.methods import Method, build_methods
from benchmarks.methods.fpfh import FpfhRansac
from benchmarks.methods.geometric_cvo import geometric_cvo
from benchmarks.odometry.followers import (
    MEASURED,
    Follower,
    LocalFollower,
    OurFollower,
    SampledFrame,
    as_measured,
)
from benchmarks.odometry.local_methods import LocalCvo, LocalIcp, LocalSmallGicp, RansacIcp
from benchmarks.odometry.options import ADAPTED, check_options, odometry_parser
from benchmarks.odometry.pairs import pair_scores, pair_sheets
from benchmarks.odometry.residual import HeldOutSurface
from benchmarks.odometry.scores import TrajectoryScore, trajectory_sheet
from benchmarks.provenance import Provenance
from benchmarks.results import require_folder
from benchmarks.sequence_options import sequence_folders
from benchmarks.sheet import Sheet
from benchmarks.speed_file import SpeedResults
from benchmarks.table import print_methods, print_sheets, wide_console
from model import Registrar
from model.artifact import load_artifact
from model.exceptions import InvalidOptionError
from model.odometry import DepthNoise
from model.sequence import DepthFrames, RgbdSequence, read_sequence
from training.data.rgbd import sampled_cloud

# Of the pairs, those that search by themselves; ours_sensor has no sensor to know there.
_PAIR_METHODS = {"ours", ADAPTED, "icp", "gicp", "small_gicp", "ransac"}


def odometry_command(arguments: list[str], command: str) -> int:
    """Follow a camera with every method on the same clouds.

    Args:
        arguments: after the benchmark's name.
        command: the whole command, for the results file.
    """
    given = odometry_parser().parse_args(arguments)
    check_options(given)
    if given.out is not None:
        require_folder(given.out)
    provenance = Provenance.now(command)
    sequences = [read_sequence(folder) for folder in sequence_folders(given.sequence)]
    followers, absent = _followers(given)
    methods = _pair_methods(given) if given.pairs else []
    sheets: list[Sheet] = []
    with contest_progress() as progress:
        for sequence in sequences:
            sheets += _trajectories(given, sequence, followers, progress)
            if given.pairs:
                sheets += _pairs(given, sequence, methods, progress)
    settings = {follower.name: follower.settings for follower in followers}
    settings |= {f"{method.name}, pairs": method.settings for method in methods}
    results = SpeedResults(_asked(given), [provenance], settings, sheets, "odometry")
    console = wide_console()
    print_sheets(sheets, console)
    print_methods(results.methods, absent, console)
    if given.out is not None:
        results.write(given.out)
        console.print(str(given.out), soft_wrap=True, highlight=False)
    return 0


@dataclass(frozen=True, slots=True)
class _Renamed:
    """A method under another name.

    Attributes:
        name: in tables.
        method: that answers.
    """

    name: str
    method: Method

    @property
    def settings(self) -> dict[str, Any]:
        """The method's."""
        return self.method.settings

    def register(self, source: Any, target: Any, seed: int) -> Any:
        """The method's."""
        return self.method.register(source, target, seed)


def _followers(given: Namespace) -> tuple[list[Follower], list[str]]:
    """Those asked for, and why others can't take part."""
    seed = given.seed
    build: dict[str, Callable[[], Follower]] = {
        "ours": lambda: OurFollower("ours", _registrar(given.artifact), None, seed),
        "ours_sensor": lambda: OurFollower(
            "ours_sensor", _registrar(given.artifact), DepthNoise(), seed
        ),
        ADAPTED: lambda: OurFollower(ADAPTED, _registrar(given.adapted), None, seed),
        "icp": lambda: LocalFollower(LocalIcp()),
        "gicp": lambda: LocalFollower(LocalIcp(generalized=True)),
        "small_gicp": lambda: LocalFollower(LocalSmallGicp()),
        "ransac": lambda: LocalFollower(RansacIcp(FpfhRansac(), seed)),
        "geometric_cvo": lambda: LocalFollower(LocalCvo(geometric_cvo())),
    }
    found: list[Follower] = []
    absent = []
    for name in dict.fromkeys(given.methods):
        try:
            follower = build[name]()
            # The settings name the package's version, and so tell whether it is there.
            _ = follower.settings
            found.append(follower)
        except ModuleNotFoundError as error:
            absent.append(f"{name} is left out: the package {error.name} isn't installed")
    if not found:
        raise InvalidOptionError(
            "nobody takes part",
            field="methods",
            mend="name a method whose packages are installed",
        )
    return found, absent


def _registrar(artifact: str | None) -> Registrar:
    return Registrar(load_artifact(artifact))


def _pair_methods(given: Namespace) -> list[Method]:
    chosen = [name for name in dict.fromkeys(given.methods) if name in _PAIR_METHODS]
    methods: list[Method] = []
    for name in chosen:
        if name == ADAPTED:
            [ours] = build_methods(["ours"], given.adapted).methods
            methods.append(_Renamed(ADAPTED, ours))
        else:
            methods += build_methods([name], given.artifact).methods
    return methods


def _trajectories(
    given: Namespace, sequence: RgbdSequence, followers: Sequence[Follower], progress: Any
) -> list[Sheet]:
    numbers = _numbers(given, sequence)
    source = DepthFrames(sequence, given.max_depth)
    frames = [_sampled(given, sequence, number) for number in numbers]
    surfaces = [HeldOutSurface.of(source, number, given.seed) for number in numbers]
    total = len(followers) * len(given.modes) * len(frames)
    task = progress.add_task(sequence.name, total=total)
    sheets = []
    for mode in given.modes:
        scores = {}
        for follower in followers:
            # Two frames off the record: libraries load and loops are compiled then.
            follower.follow(frames[:2], mode, _ignore)
            followed = follower.follow(frames, mode, lambda: progress.advance(task))
            scores[follower.name] = TrajectoryScore.of(followed, frames, surfaces)
        scores[MEASURED] = TrajectoryScore.of(as_measured(frames), frames, surfaces)
        sheets.append(trajectory_sheet(sequence.name, mode, len(frames), scores))
    return sheets


def _ignore() -> None:
    pass


def _numbers(given: Namespace, sequence: RgbdSequence) -> list[int]:
    total = len(sequence.frames)
    chosen = range(total) if given.frames is None else given.frames
    posed = [
        number
        for number in chosen[:: given.every]
        if number < total and sequence.frames[number].T_world_camera is not None
    ]
    if len(posed) < 3:
        raise InvalidOptionError(
            "fewer than three such frames have a measured pose",
            field="frames",
            value=f"{chosen.start}-{chosen.stop - 1}, each {given.every}",
            mend=f"{sequence.name} has the frames 0-{total - 1}",
        )
    return posed


def _sampled(given: Namespace, sequence: RgbdSequence, number: int) -> SampledFrame:
    points = sampled_cloud(sequence, number, given.points, given.seed, given.max_depth)
    frame = sequence.frames[number]
    assert frame.T_world_camera is not None
    return SampledFrame(number, frame.time, points.double().numpy(), frame.T_world_camera)


def _pairs(
    given: Namespace, sequence: RgbdSequence, methods: Sequence[Method], progress: Any
) -> list[Sheet]:
    entries = list_frame_pairs(
        sequence, given.frames, given.gaps, given.columns, given.pairs, given.seed
    )
    task = progress.add_task(f"{sequence.name}, pairs", total=len(entries) * len(methods))
    found = pair_scores(
        sequence,
        entries,
        methods,
        given.points,
        given.seed,
        given.max_depth,
        lambda: progress.advance(task),
    )
    return pair_sheets(sequence.name, found)


def _asked(given: Namespace) -> dict[str, Any]:
    return {
        "sequence": ", ".join(path.name for path in given.sequence),
        "frames": "all" if given.frames is None else f"{given.frames[0]}-{given.frames[-1]}",
        "every": given.every,
        "points": given.points,
        "max_depth": given.max_depth,
        "pairs": given.pairs,
        "seed": given.seed,
    }
