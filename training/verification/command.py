"""``equivalign calibrate``: fit an artifact's verifier."""

from __future__ import annotations

from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.progress import Progress

from model import Registrar
from model.artifact import load_artifact, save_artifact
from training.shape_sources import add_shape_options, shape_sources
from training.verification.collection import judged_poses
from training.verification.fit import calibration, fit_network


def calibrate_command(argv: list[str]) -> int:
    """Fit the verifier that chooses among candidates and gives the success probability."""
    parser = ArgumentParser(
        prog="equivalign calibrate",
        description=calibrate_command.__doc__,
        formatter_class=ArgumentDefaultsHelpFormatter,
    )
    add_shape_options(parser)
    parser.add_argument("--pairs", type=int, default=400, help="pairs to fit to")
    parser.add_argument("--held-out", type=int, default=200, help="pairs to calibrate on")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    artifact = load_artifact(given.artifact)
    sources = shape_sources(given.data)
    console = Console(stderr=True)
    with Progress(console=console) as progress:
        bar = progress.add_task("pairs", total=given.pairs + given.held_out)

        def tell() -> None:
            progress.advance(bar)

        fitted = list(judged_poses(Registrar(artifact), sources, given.pairs, given.seed, tell))
        verifier = fit_network(fitted, given.seed)
        judging = Registrar(replace(artifact, verifier=verifier))
        held_out = list(judged_poses(judging, sources, given.held_out, given.seed + 1, tell))
    verifier = replace(verifier, calibration=calibration(held_out))
    save_artifact(replace(artifact, verifier=verifier), given.artifact)
    right = np.mean([pair.solved_right for pair in held_out])
    among = np.mean([bool(pair.candidates_right.any()) for pair in held_out])
    console.print(
        f"{given.artifact}: of {given.held_out} held-out pairs {right:.1%} right, "
        f"a right candidate among {among:.1%}"
    )
    return 0
