"""Draws docs/picture.svg from a registration: before, after, and some steerable vectors."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation

from app.steerable_vectors import matching_arrows
from model import Registrar
from model.se3 import pose_matrix
from training.data.pairs import RegistrationPair, pair_of_shape
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes

FloatArray = npt.NDArray[np.float64]

OUT = Path(__file__).resolve().parent.parent / "docs" / "picture.svg"
SEED = 20_241_007
POINTS = 900
WRONG_ANGLE_DEG = 1.0
ARROWS = 16
CAMERA = Rotation.from_euler("zx", [-70.0, -68.0], degrees=True)
# The source stands to the right of the target, turned far.
ROTATION = Rotation.from_rotvec([1.6, 0.9, -1.4])
TRANSLATION = -(ROTATION * CAMERA.inv()).apply([1.75, 0.0, 0.0])

# Blue and orange stay apart for colour-blind readers; all are readable on white and on black.
SOURCE, TARGET, TEXT = "#e08214", "#3b8fd4", "#808890"
SCALE, ARROW = 160.0, 0.42
WIDTH, HEIGHT = 960, 400
BEFORE, AFTER = (175.0, 190.0), (790.0, 190.0)


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points and the steerable vectors of some of them.

    Attributes:
        points: (N, 3).
        tails: (K, 3), the points whose vectors are drawn.
        vectors: (K, 3).
    """

    points: FloatArray
    tails: FloatArray
    vectors: FloatArray

    def moved(self, T: FloatArray) -> Cloud:
        """Points turn and shift, vectors turn."""
        R, t = T[:3, :3], T[:3, 3]
        return Cloud(self.points @ R.T + t, self.tails @ R.T + t, self.vectors @ R.T)


def main() -> int:
    """Register, draw and say what came out; draw nothing if the pose is wrong."""
    pair = separated_pair()
    registrar = Registrar.load()
    source, target = pair.source.double().numpy(), pair.target.double().numpy()
    result = registrar.register(source, target)
    error = result.T_target_source @ np.linalg.inv(pair.T_target_source.double().numpy())
    angle = math.degrees(Rotation.from_matrix(error[:3, :3]).magnitude())
    if angle > WRONG_ANGLE_DEG:
        print(f"The pose is {angle:.1f}° from the truth: nothing drawn.", file=sys.stderr)
        return 1
    clouds = with_vectors(registrar, source, target, result.T_target_source)
    svg = drawing(*clouds, result.T_target_source, angle)
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(svg, encoding="utf-8")
    print(f"{OUT}: {len(svg) // 1024} KiB, rotation error {angle:.2f}°")
    return 0


def separated_pair() -> RegistrationPair:
    """Two noisy, cropped, independent samples of one shape, far apart."""
    perturbation = Perturbation(
        sigma=(0.005, 0.005),
        crop_share=(0.1, 0.1),
        target_points=(POINTS, POINTS),
        source_points=(POINTS, POINTS),
    )
    shape = ProceduralShapes(seed=SEED)[0]
    pair = pair_of_shape(shape, perturbation, torch.Generator().manual_seed(SEED))
    R = torch.from_numpy(ROTATION.as_matrix()).float()
    return pair.moved(pose_matrix(R, torch.from_numpy(TRANSLATION).float()))


def with_vectors(
    registrar: Registrar, source: FloatArray, target: FloatArray, T: FloatArray
) -> tuple[Cloud, Cloud]:
    """Source and target with one of the encoder's vectors at places that correspond."""
    artifact = registrar.artifact
    arrows = matching_arrows(
        artifact.encoder(), source, target, T, artifact.settings.points, ARROWS
    )
    clouds = zip((source, target), arrows, strict=True)
    moving, fixed = (Cloud(points, arrow.tails, arrow.vectors) for points, arrow in clouds)
    return moving, fixed


def drawing(source: Cloud, target: Cloud, T: FloatArray, angle: float) -> str:
    """The picture as SVG."""
    turned = math.degrees(Rotation.from_matrix(T[:3, :3]).magnitude())
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        f'font-family="sans-serif" font-size="17" text-anchor="middle" fill="{TEXT}">',
        "<title>Two point clouds before and after registration</title>",
        _cloud(target, BEFORE, TARGET),
        _cloud(source, BEFORE, SOURCE),
        _cloud(target, AFTER, TARGET),
        _cloud(source.moved(T), AFTER, SOURCE),
        f'<path d="M590 190h50m-10 -7l12 7l-12 7" fill="none" stroke="{TEXT}" stroke-width="3"/>',
        f'<text x="{BEFORE[0] + 140}" y="{HEIGHT - 14}">before: '
        f'<tspan fill="{TARGET}">target</tspan> and <tspan fill="{SOURCE}">source</tspan>, '
        f"turned by {turned:.0f}°</text>",
        f'<text x="{AFTER[0]}" y="{HEIGHT - 14}">after: {angle:.1f}° from the true pose</text>',
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _cloud(cloud: Cloud, centre: tuple[float, float], colour: str) -> str:
    seen = _project(cloud.points, centre)
    front = seen[:, 2] > np.median(seen[:, 2])
    heads = _project(cloud.tails + ARROW * cloud.vectors, centre)
    arrows = "".join(map(_arrow, _project(cloud.tails, centre)[:, :2], heads[:, :2]))
    # A line of no length with round ends is the shortest way to write a dot.
    return "\n".join(
        [
            f'<g fill="none" stroke="{colour}" stroke-linecap="round" stroke-linejoin="round">',
            f'<path stroke-width="2.6" stroke-opacity=".45" d="{_dots(seen[~front])}"/>',
            f'<path stroke-width="3.2" stroke-opacity=".75" d="{_dots(seen[front])}"/>',
            f'<path stroke-width="2" d="{arrows}"/>',
            "</g>",
        ]
    )


def _project(points: FloatArray, centre: tuple[float, float]) -> FloatArray:
    """(N, 3): two coordinates on the page and the depth, the nearest with the largest."""
    seen = CAMERA.apply(points)
    return np.column_stack(
        [centre[0] + SCALE * seen[:, 0], centre[1] - SCALE * seen[:, 1], seen[:, 2]]
    )


def _dots(seen: FloatArray) -> str:
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in seen[:, :2])


def _arrow(tail: FloatArray, head: FloatArray) -> str:
    along = (head - tail) / max(float(np.linalg.norm(head - tail)), 1e-9)
    across = np.array([-along[1], along[0]])
    left, right = (head - 6.0 * along + side * across for side in (-3.5, 3.5))
    (a, b), (c, d), (e, f), (g, h) = tail, head, left, right
    return f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}M{e:.1f} {f:.1f}L{c:.1f} {d:.1f}L{g:.1f} {h:.1f}"


if __name__ == "__main__":
    sys.exit(main())
