"""Seconds an iteration of the paper's inner loop."""

from __future__ import annotations

import time

import torch

from benchmarks.global_speed import POINTS, RacePairs
from benchmarks.sheet import Sheet
from model.artifact import Artifact
from model.cloud_function import CloudFunction
from model.inner_loop import GradientLoop
from model.kernel import RkhsKernel
from model.normalization import JointFrame

ITERATIONS = 20
_PRINTED = "0.03–0.1"


def gradient_sheet(artifact: Artifact, seed: int) -> Sheet:
    """Our gradient loop at 1024 points with features, beside what the paper states.

    Args:
        artifact: the encoder and the kernel.
        seed: of the pair.
    """
    [pair] = RacePairs(1, seed)
    frame = JointFrame.of(pair.target, pair.source)
    encoder, kernel = artifact.encoder(), RkhsKernel(artifact.kernel)
    # Nothing may converge before its iterations are over.
    loop = GradientLoop(iterations=ITERATIONS, tolerance=0.0)
    with torch.no_grad():
        clouds = [
            torch.from_numpy(points).float()[None]
            for points in (frame.target(pair.target), frame.source(pair.source))
        ]
        target, source = (CloudFunction.of(x, encoder(x)) for x in clouds)
        loop.solve(kernel, target, source, torch.eye(4)[None])
        start = time.perf_counter()
        solution = loop.solve(kernel, target, source, torch.eye(4)[None])
        seconds = (time.perf_counter() - start) / len(solution.steps)
    return Sheet(
        f"gradient inner loop, {POINTS} points with features",
        ["where", "s/iteration"],
        [
            [f"here, mean of {len(solution.steps)} iterations", f"{seconds:.4f}"],
            ["the paper, on a V100 (printed)", _PRINTED],
        ],
    )
