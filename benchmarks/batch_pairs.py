"""Many small pairs and their manifest, as ``equivalign batch`` takes them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from training.data.motion import Motion
from training.data.pairs import pair_of_shape
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes

MANIFEST = "pairs.jsonl"
_SHAPES = 200


def write_batch(folder: Path, pairs: int, points: int, seed: int) -> Path:
    """Write pairs of independent, noisy samples at any rotation, unless they are there already.

    Args:
        folder: of the clouds and the manifest.
        pairs: how many.
        points: of each cloud.
        seed: of everything random.

    Returns:
        The manifest.
    """
    manifest = folder / MANIFEST
    if manifest.exists() and len(manifest.read_text().splitlines()) == pairs:
        return manifest
    folder.mkdir(parents=True, exist_ok=True)
    shapes = ProceduralShapes(points=2 * points, seed=seed)
    spoilt = Perturbation(
        sigma=(0.01, 0.01), target_points=(points, points), source_points=(points, points)
    )
    motion = Motion(rotation="haar", max_translation=0.5)
    generator = torch.Generator().manual_seed(seed)
    lines = []
    for number in range(pairs):
        made = pair_of_shape(shapes[number % _SHAPES], spoilt, generator)
        made = made.moved(motion.draw(generator))
        row = {"source": f"source-{number:06}.npy", "target": f"target-{number:06}.npy"}
        np.save(folder / row["source"], made.source.double().numpy())
        np.save(folder / row["target"], made.target.double().numpy())
        lines.append(json.dumps({"pair_id": f"{number:06}", "seed": number, **row}))
    manifest.write_text("\n".join(lines) + "\n")
    return manifest
