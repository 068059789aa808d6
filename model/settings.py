"""The solver's defaults, as an artifact stores them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from model.exceptions import InvalidOptionError
from model.inner_loop import GradientLoop, ProcrustesLoop
from model.search.candidates import SearchLevel, SearchSettings
from model.search.consensus import ConsensusSettings
from model.search.grid_poses import GridLevel
from model.search.hypothesise import HypothesisSettings
from model.surface import SurfaceLoop


@dataclass(frozen=True, slots=True)
class RegistrarSettings:
    """Everything about a registration that isn't the clouds.

    Attributes:
        solver: inner loop that is used unless the caller names one.
        points: points of each cloud that are encoded and searched with.
        local_points: the same where the search is local: nothing is matched then.
        dense_points: points of each cloud that the last stage works on.
        hypotheses: which start poses there are.
        search: of the global search.
        learned_normals: whether the artifact's network corrects the fitted normals, if it has one.
        surface: Gauss–Newton and Newton steps on the surface kernel, as the last stage.
        surface_features: whether the features take part in that.
        nudges: how often its answer for sparse clouds slides on where the judge clearly gains.
        procrustes: the closed-form inner loop, as the last stage.
        gradient: the paper's inner loop, as the last stage.
    """

    solver: str = "surface"
    points: int = 420
    local_points: int = 256
    dense_points: int = 20_000
    hypotheses: HypothesisSettings = field(default_factory=HypothesisSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    learned_normals: bool = True
    surface: SurfaceLoop = field(default_factory=SurfaceLoop)
    surface_features: bool = False
    nudges: int = 3
    procrustes: ProcrustesLoop = field(
        default_factory=lambda: ProcrustesLoop(lengthscale=0.05, lengthscale_end=0.02)
    )
    gradient: GradientLoop = field(
        default_factory=lambda: GradientLoop(lengthscale=0.05, lengthscale_bounds=(0.02, 0.1))
    )

    def hypotheses_for(self, search: str) -> HypothesisSettings:
        """Start poses of a global search, or the guess alone for a local one."""
        if search == "global":
            return self.hypotheses
        return replace(
            self.hypotheses,
            identity=False,
            triplets=False,
            matches=0,
            more_matches=0,
            flips=0,
            shifts=0,
            slides=0,
            grid_step_deg=0.0,
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
                values["hypotheses"] = _hypotheses(values["hypotheses"])
            if "search" in values:
                values["search"] = _search(values["search"])
            if "surface" in values:
                values["surface"] = SurfaceLoop(**values["surface"])
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
    if "levels" in values:
        values["levels"] = [SearchLevel(**level) for level in values["levels"]]
    return SearchSettings(**values)


def _hypotheses(plain: Mapping[str, Any]) -> HypothesisSettings:
    values = dict(plain)
    if "consensus" in values:
        consensus = dict(values["consensus"])
        if "tightening" in consensus:
            consensus["tightening"] = tuple(consensus["tightening"])
        values["consensus"] = ConsensusSettings(**consensus)
    if "grid_levels" in values:
        values["grid_levels"] = [GridLevel(**level) for level in values["grid_levels"]]
    return HypothesisSettings(**values)
