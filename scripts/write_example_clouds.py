"""Writes examples/source.ply and examples/target.ply, the pair that the README registers."""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from model.cloud_file import write_points
from training.data.motion import Motion
from training.data.pairs import pair_of_shape
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes

FOLDER = Path(__file__).resolve().parent.parent / "examples"
SEED = 20_241_008


def main() -> int:
    """Two noisy, cropped, independent samples of one made-up shape, turned by any angle."""
    generator = torch.Generator().manual_seed(SEED)
    perturbation = Perturbation(
        sigma=(0.005, 0.005),
        crop_share=(0.1, 0.1),
        target_points=(800, 800),
        source_points=(600, 600),
    )
    pair = pair_of_shape(ProceduralShapes(seed=SEED)[0], perturbation, generator)
    pair = pair.moved(Motion(rotation="haar", max_translation=0.5).draw(generator))
    write_points(FOLDER / "source.ply", pair.source.double().numpy())
    write_points(FOLDER / "target.ply", pair.target.double().numpy())
    print(f"T_target_source =\n{pair.T_target_source.double().numpy().round(4)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
