"""``equivalign normals``: train an artifact's normal network."""

from __future__ import annotations

from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser
from dataclasses import replace

from rich.console import Console
from rich.progress import Progress

from model.artifact import load_artifact, save_artifact
from training.normals.clouds import labelled_clouds
from training.normals.fit import fit_normals, median_angle_deg
from training.shape_sources import add_shape_options, shape_sources


def normals_command(argv: list[str]) -> int:
    """Train the network that corrects fitted normals, on shapes whose normals are known.

    A verifier that was fitted with other normals has to be fitted again.
    """
    parser = ArgumentParser(
        prog="equivalign normals",
        description=normals_command.__doc__,
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    add_shape_options(parser)
    parser.add_argument("--clouds", type=int, default=3000, help="clouds to train on")
    parser.add_argument("--held-out", type=int, default=200, help="clouds to measure on")
    parser.add_argument("--steps", type=int, default=5000, help="of training, on 4 clouds each")
    parser.add_argument("--rounds", type=int, default=3, help="of votes")
    parser.add_argument("--hidden", type=int, default=16, help="units that weigh a neighbour")
    parser.add_argument("--memory", type=int, default=8, help="numbers that a point keeps")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    artifact = load_artifact(given.artifact)
    sources = shape_sources(given.data)
    console = Console(stderr=True)
    with Progress(console=console) as progress:
        bar = progress.add_task("clouds", total=given.clouds)
        clouds = []
        for cloud in labelled_clouds(sources, given.clouds, given.seed):
            clouds.append(cloud)
            progress.advance(bar)
        bar = progress.add_task("steps", total=given.steps)
        network = fit_normals(
            clouds,
            given.steps,
            given.seed,
            lambda: progress.advance(bar),
            rounds=given.rounds,
            hidden=given.hidden,
            memory=given.memory,
        )
    held_out = list(labelled_clouds(sources, given.held_out, given.seed + 1))
    before, after = median_angle_deg(None, held_out), median_angle_deg(network, held_out)
    save_artifact(replace(artifact, normals=network), given.artifact)
    console.print(
        f"{given.artifact}: normals of {given.held_out} held-out clouds are off by {after:.1f}° "
        f"in the median, fitted ones by {before:.1f}°"
    )
    return 0
