"""The solver's defaults, as an artifact stores them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from model.exceptions import InvalidOptionError
from model.inner_loop import GradientLoop, ProcrustesLoop
from model.search.hypotheses import HypothesisSettings
from model.search.multi_start import SearchLevel, SearchSettings


@dataclass(frozen=True, slots=True)
class RegistrarSettings:
    """Everything about a registration that isn't the clouds.

    Attributes:
        solver: inner loop that is used unless the caller names one.
        points: points of each cloud that the solver works on.
        hypotheses: which start poses there are.
        search: of the global search.
        procrustes: the closed-form inner loop of the last stage.
        gradient: the paper's inner loop, as the last stage.
    """

    solver: str = "procrustes"
    points: int = 1024
    hypotheses: HypothesisSettings = field(default_factory=HypothesisSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    procrustes: ProcrustesLoop = field(
        default_factory=lambda: ProcrustesLoop(lengthscale=0.05, lengthscale_end=0.02)
    )
    gradient: GradientLoop = field(
        default_factory=lambda: GradientLoop(lengthscale=0.05, lengthscale_bounds=(0.02, 0.1))
    )

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> RegistrarSettings:
        """The inverse of ``as_dict``; what is left out keeps its default.

        Raises:
            InvalidOptionError: an entry that doesn't exist or has the wrong form.
        """
        values = dict(plain)
        try:
            if "hypotheses" in values:
                values["hypotheses"] = HypothesisSettings(**values["hypotheses"])
            if "search" in values:
                values["search"] = _search(values["search"])
            if "procrustes" in values:
                values["procrustes"] = ProcrustesLoop(**values["procrustes"])
            if "gradient" in values:
                gradient = dict(values["gradient"])
                if "lengthscale_bounds" in gradient:
                    low, high = gradient["lengthscale_bounds"]
                    gradient["lengthscale_bounds"] = (low, high)
                values["gradient"] = GradientLoop(**gradient)
            return cls(**values)
        except (TypeError, ValueError) as error:
            raise InvalidOptionError(
                f"a solver setting is unknown or has the wrong form: {error}",
                field="solver",
                mend="see RegistrarSettings",
            ) from None


def _search(plain: Mapping[str, Any]) -> SearchSettings:
    values = dict(plain)
    for name in ("levels", "grid_levels"):
        if name in values:
            values[name] = [SearchLevel(**level) for level in values[name]]
    return SearchSettings(**values)
