"""The method that does nothing: what it scores is how hard the pairs are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from benchmarks.methods.method import Answer
from benchmarks.pair import FloatArray


@dataclass(frozen=True, slots=True)
class Identity:
    """Answers that nothing moved."""

    name: ClassVar[str] = "identity"

    @property
    def settings(self) -> dict[str, Any]:
        """See Method.settings; there are none."""
        return {}

    def register(self, source: FloatArray, target: FloatArray, seed: int) -> Answer:
        """See Method.register."""
        return Answer(np.eye(4))
