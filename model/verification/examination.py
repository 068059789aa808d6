"""What a verifier is fitted on: every pose of one registration, with its evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.verification.evidence import Evidence

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Examination:
    """Of one registration; poses are T_target_source in the input's unit.

    Attributes:
        candidates: (K, 4, 4) what the search left, best first, before the last stage.
        candidate_evidence: of the candidates, by a close look.
        answer: (4, 4) solved.
        answer_evidence: of the answer alone.
        log_odds: the judge's score of the answer.
        lead: by which it exceeds that of the best runner-up; None without one.
    """

    candidates: FloatArray
    candidate_evidence: Evidence
    answer: FloatArray
    answer_evidence: Evidence
    log_odds: float
    lead: float | None
