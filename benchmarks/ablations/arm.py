"""One row of a study: an artifact under the inner loop alone, and in the whole method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.methods import Method
from benchmarks.methods.equivalign import EquivAlign
from benchmarks.methods.single_start import SingleStart
from model import Registrar
from model.artifact import Artifact
from model.inner_loop import ProcrustesLoop

# The paper's own figures for large angles need a wide first kernel (section 5.3).
FIRST_LENGTHSCALE = 0.5
_LAST_LENGTHSCALE = 0.05


@dataclass(frozen=True, slots=True)
class Arm:
    """What takes part in a study.

    Attributes:
        one_start: methods without a search, for turns of a known angle.
        search: whole methods, for any turn.
    """

    one_start: Sequence[Method] = field(default_factory=list)
    search: Sequence[Method] = field(default_factory=list)


def both(label: str, artifact: Artifact, note: str) -> Arm:
    """An artifact from one start and with the search.

    Args:
        label: of the row.
        artifact: the weights, the kernel and the solver's settings.
        note: where it comes from.
    """
    return Arm([one_start(label, artifact, note)], [search(label, artifact, note)])


def one_start(
    label: str, artifact: Artifact, note: str, lengthscale: float = FIRST_LENGTHSCALE
) -> Method:
    """Kernel-weighted Procrustes steps from no rotation, ℓ shrinking from ``lengthscale``."""
    loop = ProcrustesLoop(lengthscale=lengthscale, lengthscale_end=_LAST_LENGTHSCALE, record=False)
    return SingleStart.of(f"{label}, one start", artifact, loop, note)


def search(label: str, artifact: Artifact, note: str) -> Method:
    """The method as it ships, with this artifact."""
    return EquivAlign(f"{label}, search", Registrar(artifact), note=note)


def with_hypotheses(artifact: Artifact, **changed: Any) -> Artifact:
    """The artifact with some of its HypothesisSettings changed."""
    settings = artifact.settings
    hypotheses = replace(settings.hypotheses, **changed)
    return replace(artifact, settings=replace(settings, hypotheses=hypotheses))
