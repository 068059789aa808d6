"""Global search: start poses, kernel fields, pruning and selection."""

from model.search.hypotheses import KINDS, Hypotheses, HypothesisSettings, hypothesise, within
from model.search.multi_start import Candidates, SearchSettings, coarse_to_fine
from model.search.selection import selection_score

__all__ = [
    "KINDS",
    "Candidates",
    "Hypotheses",
    "HypothesisSettings",
    "SearchSettings",
    "coarse_to_fine",
    "hypothesise",
    "selection_score",
    "within",
]
