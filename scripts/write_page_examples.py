"""Writes the example pairs of the service's page, and the list of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from model.cloud_file import ply_document
from training.data.motion import Motion
from training.data.pairs import pair_of_shape
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes

FloatArray = npt.NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent.parent / "app" / "page_files"
SEED = 20_241_009
# A micrometre of a shape of unit size: as fine as anybody sees, and shorter in the file.
DIGITS = 6


def main() -> int:
    """One pair that is easy, one of which a third is missing, and one that is symmetric."""
    examples = [
        _example("part", "Two scans of a part", "noisy, turned by any angle", *_scans(0.05)),
        _example("cropped", "Partial scans", "a quarter of each is missing", *_scans(0.25)),
        _example("brick", "A brick", "symmetric: several poses are right", *_bricks()),
    ]
    (FOLDER / "examples.json").write_text(json.dumps(examples, indent=2) + "\n")
    return 0


def _example(
    name: str, title: str, description: str, source: FloatArray, target: FloatArray
) -> dict[str, str]:
    told = {"title": title, "description": description}
    for role, points in (("source", source), ("target", target)):
        told[role] = f"example-{name}-{role}.ply"
        (FOLDER / told[role]).write_bytes(ply_document(points.round(DIGITS)))
    return told


def _scans(crop: float) -> tuple[FloatArray, FloatArray]:
    generator = torch.Generator().manual_seed(SEED)
    perturbation = Perturbation(
        sigma=(0.005, 0.005),
        crop_share=(crop, crop),
        target_points=(1024, 1024),
        source_points=(900, 900),
    )
    pair = pair_of_shape(ProceduralShapes(seed=SEED)[0], perturbation, generator)
    pair = pair.moved(Motion(rotation="haar", max_translation=0.8).draw(generator))
    return pair.source.double().numpy(), pair.target.double().numpy()


def _bricks() -> tuple[FloatArray, FloatArray]:
    """Two samples of a box with unequal sides, which half turns map onto itself."""
    random = np.random.default_rng(SEED)
    half = np.array([1.0, 0.5, 0.3])
    R = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(SEED)).double())
    turn = R.Q.numpy() * np.sign(np.linalg.det(R.Q.numpy()))
    source, target = (_box(half, 900, random) for _ in range(2))
    return source, target @ turn.T + np.array([0.6, -0.3, 0.4])


def _box(half: FloatArray, count: int, random: np.random.Generator) -> FloatArray:
    points = random.uniform(-half, half, (count, 3))
    areas = half.prod() / half
    axis = random.choice(3, count, p=areas / areas.sum())
    points[np.arange(count), axis] = half[axis] * random.choice([-1.0, 1.0], count)
    return points


if __name__ == "__main__":
    sys.exit(main())
