"""Outer losses, chosen by name; each says whether it looks at the transform the data made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from torch import Tensor, nn

from model.exceptions import InvalidOptionError
from training.loss.alignment import Alignment
from training.loss.contrast import (
    MatchingContrast,
    PoseContrast,
    feature_likeness,
    invariant_likeness,
)
from training.loss.rkhs import RkhsCosine, RkhsDistance
from training.loss.spread import SpreadFloor

LOSSES: dict[str, Callable[..., nn.Module]] = {
    "rkhs_distance": RkhsDistance,
    "rkhs_distance_released_sign": partial(RkhsDistance, sign=-1.0),
    "rkhs_cosine": RkhsCosine,
    "rkhs_cosine_detached": partial(RkhsCosine, detach_self_terms=True),
    "pose_contrast": PoseContrast,
    "pose_contrast_solved": partial(PoseContrast, reference="solved"),
    "feature_contrast": partial(MatchingContrast, feature_likeness),
    "feature_contrast_solved": partial(MatchingContrast, feature_likeness, reference="solved"),
    "invariant_contrast": partial(MatchingContrast, invariant_likeness, temperature=20.0),
    "invariant_contrast_solved": partial(
        MatchingContrast, invariant_likeness, reference="solved", temperature=20.0
    ),
    "spread_floor": SpreadFloor,
}


class OuterLoss(nn.Module):
    """A weighted sum of terms.

    Args:
        weights: weight of each term, by its name in ``LOSSES``.
        settings: arguments of single terms.

    Raises:
        InvalidOptionError: an unknown term, or an argument it doesn't have.
    """

    def __init__(
        self,
        weights: Mapping[str, float],
        settings: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        super().__init__()
        unknown = [name for name in (*weights, *(settings or {})) if name not in LOSSES]
        if unknown or not weights:
            raise InvalidOptionError(
                "unknown loss" if unknown else "no loss at all",
                field="loss",
                value=unknown or dict(weights),
                mend=f"choose among {', '.join(LOSSES)}",
            )
        self.weights = dict(weights)
        try:
            self.terms = nn.ModuleDict(
                {name: LOSSES[name](**(settings or {}).get(name, {})) for name in weights}
            )
        except TypeError as error:
            raise InvalidOptionError(
                f"a loss can't be built: {error}",
                field="loss_settings",
                value=settings,
                mend="see the loss's arguments",
            ) from None

    @property
    def needs_solution(self) -> bool:
        """Whether any term looks at ĥ."""
        return any(bool(term.uses_solution) for term in self.terms.values())

    def transforms_used(self) -> dict[str, str]:
        """For each term, which pose it looks at: for configurations, artifacts and readers."""
        return {name: _pose_used(term) for name, term in self.terms.items()}

    def forward(self, alignment: Alignment) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted sum, and every term by name."""
        values = {name: term(alignment) for name, term in self.terms.items()}
        total = sum(self.weights[name] * value for name, value in values.items())
        assert isinstance(total, Tensor)
        return total, values


def _pose_used(term: nn.Module) -> str:
    if term.uses_made_transform:
        return "self-made transform"
    return "solved pose only" if term.uses_solution else "no pose"


__all__ = ["LOSSES", "Alignment", "OuterLoss"]
