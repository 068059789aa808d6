"""Bodies whose geometry tests can predict."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from training.data.profile import FloatArray, IntArray, strip
from training.data.solid import Prism

CUBE_VERTICES: FloatArray = np.array(
    [[x, y, z] for x in (0.0, 2.0) for y in (0.0, 2.0) for z in (0.0, 2.0)]
)
# Six faces of four corners, counter-clockwise from outside.
CUBE_FACES = (
    (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3),
)  # fmt: skip


def angle_bar() -> tuple[FloatArray, IntArray]:
    """A mesh without symmetry: an L section, sheared."""
    line = np.array([[-1.0, 1.0], [-1.0, -1.0], [0.6, -1.0]])
    vertices, faces = Prism(strip(line, 0.3)).surface
    return vertices @ np.array([[1.0, 0.0, 0.4], [0.0, 1.5, 0.0], [0.0, 0.0, 0.7]]), faces


def write_off(
    path: Path, vertices: FloatArray, faces: object, header: str = "OFF\n{} {} 0\n"
) -> None:
    rows = [" ".join(f"{value:.6f}" for value in vertex) for vertex in vertices]
    rows += [f"{len(face)} {' '.join(map(str, face))}" for face in faces]  # type: ignore[attr-defined]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(header.format(len(vertices), len(faces)) + "\n".join(rows) + "\n")  # type: ignore[arg-type]
