"""What every registration method of a benchmark has in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from benchmarks.pair import FloatArray


@dataclass(frozen=True, slots=True)
class Answer:
    """A method's pose and what it says about it.

    Attributes:
        T_target_source: (4, 4).
        findings: plain values for the results file, such as ``success_probability``.
        candidates: other poses (4, 4) that it considered to the end.
    """

    T_target_source: FloatArray
    findings: dict[str, Any] = field(default_factory=dict)
    candidates: Sequence[FloatArray] = ()


class Method(Protocol):
    """Registers two clouds and knows nothing else about them."""

    @property
    def name(self) -> str:
        """In options, files and tables."""
        ...

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that decides its answers, as plain values; printed with the tables."""
        ...

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """Find the pose of the source (M, 3) in the target (N, 3)."""
        ...
