"""Which of several poses is right, and how likely: small networks on the evidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from model.exceptions import InvalidOptionError
from model.verification.contact import TRAITS
from model.verification.evidence import NAMES, Evidence

FloatArray = npt.NDArray[np.float64]


class Judge(Protocol):
    """Tells which of several poses is right.

    Attributes:
        DOUBT: where even the best pose scores less, it pays to search on.
        CLOSE: poses that score less than the best by no more than this may be better.
        CLOSELY: whether it wants to see how every point meets the other cloud.
    """

    DOUBT: float
    CLOSE: float
    CLOSELY: bool

    def log_odds(self, evidence: Evidence) -> FloatArray:
        """Of each pose's being right, (K,)."""
        ...


@dataclass(frozen=True, slots=True)
class Perceptron:
    """W₂ tanh(W₁ x + b₁) + b₂.

    Attributes:
        hidden_weight: (H, I) W₁.
        hidden_bias: (H,) b₁.
        out_weight: (O, H) W₂.
        out_bias: (O,) b₂.
    """

    hidden_weight: FloatArray
    hidden_bias: FloatArray
    out_weight: FloatArray
    out_bias: FloatArray

    def __call__(self, x: FloatArray) -> FloatArray:
        """(…, I) → (…, O)."""
        hidden = np.tanh(x @ self.hidden_weight.T + self.hidden_bias)
        out: FloatArray = hidden @ self.out_weight.T + self.out_bias
        return out

    def check(self, inputs: int, outputs: int | None = None) -> int:
        """Its outputs.

        Raises:
            ValueError: its shapes don't fit together or to what goes in and out.
        """
        width = len(self.hidden_bias)
        out = len(self.out_bias) if outputs is None else outputs
        if self.hidden_weight.shape != (width, inputs) or self.out_weight.shape != (out, width):
            raise ValueError("its layers don't fit together")
        if self.out_bias.shape != (out,):
            raise ValueError("its layers don't fit together")
        return out


@dataclass(frozen=True, slots=True)
class Verifier:
    """A glance at the evidence, or a close look at how every point meets the other cloud.

    Fitted on pairs that the data pipeline made. The close look is a deep set: a perceptron on the
    traits of each point, the mean of its tanh over the points of both clouds, and a perceptron on
    that together with the evidence.

    Attributes:
        mean: (E,) of the evidence.
        scale: (E,) its standard deviation.
        trait_mean: (F,) of the points' traits.
        trait_scale: (F,) their standard deviation.
        glance: E → 1.
        points: F → D.
        verdict: E + D → 1.
        calibration: (3,) the probability of the answer is the logistic function of c₀ +
            c₁ · its log-odds + c₂ · its lead over the runner-up, bounded.
    """

    mean: FloatArray
    scale: FloatArray
    trait_mean: FloatArray
    trait_scale: FloatArray
    glance: Perceptron
    points: Perceptron
    verdict: Perceptron
    calibration: FloatArray

    # A lead beyond this adds nothing.
    LEAD = 6.0
    # Odds below 12 to 1 leave a doubt.
    DOUBT = 2.5
    CLOSE = 3.0
    CLOSELY = True

    def log_odds(self, evidence: Evidence) -> FloatArray:
        """Of each pose's being right, (K,): by a close look where there is one."""
        e = (evidence.values - self.mean) / self.scale
        if evidence.contacts is None:
            return self.glance(e)[:, 0] + evidence.label_odds
        traits = (evidence.contacts - self.trait_mean) / self.trait_scale
        seen = np.tanh(self.points(traits)).mean(axis=(1, 2))
        return self.verdict(np.concatenate([e, seen], axis=1))[:, 0] + evidence.label_odds

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
        return {"evidence": list(NAMES), "traits": list(TRAITS), **_plain(asdict(self))}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Verifier:
        """The inverse of ``as_dict``.

        Raises:
            InvalidOptionError: fitted to other evidence, or an entry is missing or misshapen.
        """
        try:
            if tuple(plain["evidence"]) != NAMES or tuple(plain["traits"]) != TRAITS:
                raise ValueError("fitted to other evidence than this program collects")
            verifier = cls(
                mean=_numbers(plain["mean"], (len(NAMES),)),
                scale=_numbers(plain["scale"], (len(NAMES),)),
                trait_mean=_numbers(plain["trait_mean"], (len(TRAITS),)),
                trait_scale=_numbers(plain["trait_scale"], (len(TRAITS),)),
                glance=_perceptron(plain["glance"]),
                points=_perceptron(plain["points"]),
                verdict=_perceptron(plain["verdict"]),
                calibration=_numbers(plain["calibration"], (3,)),
            )
            verifier.glance.check(len(NAMES), 1)
            verifier.verdict.check(len(NAMES) + verifier.points.check(len(TRAITS)), 1)
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
    CLOSE = 1.0
    CLOSELY = False

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


def _perceptron(plain: Mapping[str, Any]) -> Perceptron:
    return Perceptron(
        **{
            field.name: _numbers(plain[field.name], (-1, -1) if "weight" in field.name else (-1,))
            for field in fields(Perceptron)
        }
    )


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: _plain(value) if isinstance(value, dict) else value.tolist()
        for name, value in values.items()
    }


def _numbers(values: Sequence[Any], shape: tuple[int, ...]) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.ndim != len(shape) or not np.isfinite(array).all():
        raise ValueError("an entry isn't an array of finite numbers")
    if any(want not in (-1, have) for want, have in zip(shape, array.shape, strict=True)):
        raise ValueError(f"an entry has shape {array.shape}")
    return array
