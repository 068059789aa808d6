"""What people want to see of a registration: words, notations, and something to draw."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field

from app.findings import findings, verdict
from app.notations import notations
from app.steerable_vectors import Arrows, matching_arrows
from model import Registrar, RegistrationResult

FloatArray = npt.NDArray[np.float64]

SHOWN_POINTS = 6000


class Line(BaseModel):
    """One thing that is said."""

    subject: str
    statement: str


class Drawing(BaseModel):
    """One cloud, as it came, to be drawn."""

    points: list[list[float]] = Field(description="At most some thousands of its points.")
    total: int = Field(description="Points that the cloud has.")
    arrow_tails: list[list[float]] = Field(description="Where steerable vectors stand.")
    arrow_vectors: list[list[float]] = Field(
        description="The vectors, the longest of length 1; they turn with the cloud."
    )


class Explanation(BaseModel):
    """The answer, for people."""

    verdict: str = Field(description="Whether to trust it, in one sentence.")
    findings: list[Line] = Field(description="The diagnostics in words.")
    notations: list[Line] = Field(description="The pose as other programs write it.")
    source: Drawing
    target: Drawing


def explain(
    registrar: Registrar, source: FloatArray, target: FloatArray, result: RegistrationResult
) -> Explanation:
    """Explain a result.

    Args:
        registrar: that found it.
        source: (M, 3), in the input's unit.
        target: (N, 3), in the input's unit.
        result: of their registration.
    """
    artifact = registrar.artifact
    arrows = matching_arrows(
        artifact.encoder(), source, target, result.T_target_source, artifact.settings.points
    )
    return Explanation(
        verdict=verdict(result.diagnostics),
        findings=_lines(findings(result.diagnostics)),
        notations=_lines(notations(result.T_target_source)),
        source=_drawing(source, arrows[0]),
        target=_drawing(target, arrows[1]),
    )


def thinned(points: FloatArray, most: int) -> FloatArray:
    """At most so many of the points, always the same ones."""
    if len(points) <= most:
        return points
    kept = np.random.default_rng(0).choice(len(points), most, replace=False)
    return points[np.sort(kept)]


def _lines(pairs: list[tuple[str, str]]) -> list[Line]:
    return [Line(subject=subject, statement=statement) for subject, statement in pairs]


def _drawing(points: FloatArray, arrows: Arrows) -> Drawing:
    return Drawing(
        points=thinned(points, SHOWN_POINTS).tolist(),
        total=len(points),
        arrow_tails=arrows.tails.tolist(),
        arrow_vectors=arrows.vectors.tolist(),
    )
