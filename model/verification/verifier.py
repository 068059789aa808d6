"""Which of several poses is right, and how likely: a small network on the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from model.exceptions import InvalidOptionError
from model.verification.evidence import NAMES, Evidence

FloatArray = npt.NDArray[np.float64]


class Judge(Protocol):
    """Tells which of several poses is right.

    Attributes:
        DOUBT: where even the best pose scores less, it pays to search on.
    """

    DOUBT: float

    def log_odds(self, evidence: Evidence) -> FloatArray:
        """Of each pose's being right, (K,)."""
        ...


@dataclass(frozen=True, slots=True)
class Verifier:
    """log-odds = w₂ · tanh(W₁ (e − μ)/σ + b₁) + b₂, fitted on pairs that the data pipeline made.

    Attributes:
        mean: (E,) μ of the evidence.
        scale: (E,) σ.
        hidden_weight: (H, E) W₁.
        hidden_bias: (H,) b₁.
        out_weight: (H,) w₂.
        out_bias: b₂.
        calibration: (3,) the probability of the answer is the logistic function of c₀ +
            c₁ · its log-odds + c₂ · its lead over the runner-up, bounded.
    """

    mean: FloatArray
    scale: FloatArray
    hidden_weight: FloatArray
    hidden_bias: FloatArray
    out_weight: FloatArray
    out_bias: float
    calibration: FloatArray

    # A lead beyond this adds nothing.
    LEAD = 6.0
    # Odds below 12 to 1 leave a doubt.
    DOUBT = 2.5

    def log_odds(self, evidence: Evidence) -> FloatArray:
        """Of each pose's being right, (K,)."""
        e = (evidence.values - self.mean) / self.scale
        hidden = np.tanh(e @ self.hidden_weight.T + self.hidden_bias)
        odds: FloatArray = hidden @ self.out_weight + self.out_bias + evidence.label_odds
        return odds

    def probability(self, log_odds: float, lead: float) -> float:
        """Of the answer's being right.

        Args:
            log_odds: of the answer.
            lead: by which the runner-up's fall short of it; negative if they don't.
        """
        c = self.calibration
        x = c[0] + c[1] * log_odds + c[2] * float(np.clip(lead, -self.LEAD, self.LEAD))
        return float(1.0 / (1.0 + np.exp(-np.clip(x, -30.0, 30.0))))

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "evidence": list(NAMES),
            "mean": self.mean.tolist(),
            "scale": self.scale.tolist(),
            "hidden_weight": self.hidden_weight.tolist(),
            "hidden_bias": self.hidden_bias.tolist(),
            "out_weight": self.out_weight.tolist(),
            "out_bias": self.out_bias,
            "calibration": self.calibration.tolist(),
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Verifier:
        """The inverse of ``as_dict``.

        Raises:
            InvalidOptionError: fitted to other evidence, or an entry is missing or misshapen.
        """
        try:
            if tuple(plain["evidence"]) != NAMES:
                raise ValueError("fitted to other evidence than this program collects")
            verifier = cls(
                mean=_numbers(plain["mean"], (len(NAMES),)),
                scale=_numbers(plain["scale"], (len(NAMES),)),
                hidden_weight=_numbers(plain["hidden_weight"], (-1, len(NAMES))),
                hidden_bias=_numbers(plain["hidden_bias"], (-1,)),
                out_weight=_numbers(plain["out_weight"], (-1,)),
                out_bias=float(plain["out_bias"]),
                calibration=_numbers(plain["calibration"], (3,)),
            )
            width = len(verifier.hidden_weight)
            if len(verifier.hidden_bias) != width or len(verifier.out_weight) != width:
                raise ValueError("its layers have different widths")
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidOptionError(
                f"the verifier can't be used: {error}",
                field="verifier",
                mend="fit it again with `equivalign calibrate`",
            ) from None
        return verifier


class SurfaceAgreement:
    """The judge of an artifact without a verifier: a product of shares, as log-odds of sorts.

    The share of points that lie on the other surface and the share of matches that agree: a pose
    that overlaps too much but fits loosely has little of the first.
    """

    # A fully overlapping, noisy pair scores about −1.
    DOUBT = -1.2

    def log_odds(self, evidence: Evidence) -> FloatArray:
        """Of each pose, (K,)."""
        return surface_agreement(evidence)


def surface_agreement(evidence: Evidence) -> FloatArray:
    """log(share on the surface) + ½ log(share of matches that agree), (K,)."""
    on = evidence.values[:, NAMES.index("surface_least")]
    also = evidence.values[:, NAMES.index("surface_mean")]
    support = evidence.values[:, NAMES.index("support_share")]
    score: FloatArray = np.log(0.02 + 0.5 * (on + also)) + 0.5 * np.log(0.02 + support)
    return score + evidence.label_odds


def _numbers(values: Sequence[Any], shape: tuple[int, ...]) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.ndim != len(shape) or not np.isfinite(array).all():
        raise ValueError("an entry isn't an array of finite numbers")
    if any(want not in (-1, have) for want, have in zip(shape, array.shape, strict=True)):
        raise ValueError(f"an entry has shape {array.shape}")
    return array
