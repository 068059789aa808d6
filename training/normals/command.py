"""``equivalign normals``: train an artifact's normal network."""

from __future__ import annotations

from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

from rich.console import Console
from rich.progress import Progress

from model.artifact import Artifact, load_artifact, save_artifact
from training.data.shape import ShapeSet
from training.normals.clouds import labelled_clouds
from training.normals.fit import fit_normals, fit_pair_normals, mean_pose_loss, median_angle_deg
from training.normals.pairs import labelled_pairs
from training.shape_sources import add_shape_options, shape_sources

Item = TypeVar("Item")


def normals_command(argv: list[str]) -> int:
    """Train a network that corrects fitted normals, on shapes whose normals are known.

    That for single clouds comes first; that for pairs starts from it, and is taken where two sparse
    clouds are solved. A verifier that was fitted with other normals has to be fitted again.
    """
    parser = ArgumentParser(
        prog="equivalign normals",
        description=normals_command.__doc__,
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    add_shape_options(parser)
    parser.add_argument("--of", choices=("clouds", "pairs"), default="clouds", help="which network")
    parser.add_argument("--count", type=int, default=3000, help="clouds or pairs to train on")
    parser.add_argument("--held-out", type=int, default=200, help="of them to measure on")
    parser.add_argument("--steps", type=int, default=5000, help="of training, on 4 of them each")
    parser.add_argument("--rounds", type=int, default=3, help="of votes")
    parser.add_argument("--hidden", type=int, default=16, help="units that weigh a neighbour")
    parser.add_argument("--memory", type=int, default=8, help="numbers that a point keeps")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    artifact = load_artifact(given.artifact)
    train = _pairs_trained if given.of == "pairs" else _clouds_trained
    artifact, said = train(given, artifact, shape_sources(given.data))
    save_artifact(artifact, given.artifact)
    Console(stderr=True).print(f"{given.artifact}: {said}")
    return 0


def _clouds_trained(
    given: Namespace, artifact: Artifact, sources: Sequence[ShapeSet]
) -> tuple[Artifact, str]:
    with _Bars() as bars:
        clouds = list(bars.made(labelled_clouds(sources, given.count, given.seed), given.count))
        tell = bars.tell(given.steps)
        network = fit_normals(clouds, given.steps, given.seed, tell, **_architecture(given))
    held_out = list(labelled_clouds(sources, given.held_out, given.seed + 1))
    before, after = median_angle_deg(None, held_out), median_angle_deg(network, held_out)
    return replace(artifact, normals=network), (
        f"normals of {given.held_out} held-out clouds are off by {after:.1f}° in the median, "
        f"fitted ones by {before:.1f}°"
    )


def _pairs_trained(
    given: Namespace, artifact: Artifact, sources: Sequence[ShapeSet]
) -> tuple[Artifact, str]:
    loop = artifact.settings.surface
    with _Bars() as bars:
        pairs = list(bars.made(labelled_pairs(sources, given.count, given.seed), given.count))
        network = fit_pair_normals(
            pairs,
            artifact.normals,
            loop,
            given.steps,
            given.seed,
            bars.tell(given.steps),
            **_architecture(given),
        )
    held_out = list(labelled_pairs(sources, given.held_out, given.seed + 1))
    before = mean_pose_loss(artifact.learned_normals[1], held_out, loop, given.seed)
    after = mean_pose_loss(network, held_out, loop, given.seed)
    return replace(artifact, pair_normals=network), (
        f"the loss of {given.held_out} held-out pairs' poses is {after:.3f}, "
        f"with the network that the artifact had {before:.3f}"
    )


def _architecture(given: Namespace) -> dict[str, int]:
    return {"rounds": given.rounds, "hidden": given.hidden, "memory": given.memory}


class _Bars(Progress):
    """One bar for what is made, one for the steps."""

    def __init__(self) -> None:
        super().__init__(console=Console(stderr=True))

    def made(self, items: Iterable[Item], count: int) -> Iterator[Item]:
        return iter(self.track(items, count, description="made"))

    def tell(self, steps: int) -> Callable[[], None]:
        bar = self.add_task("steps", total=steps)
        return lambda: self.advance(bar)
