"""Global search: start poses, and the few of them worth solving."""

from model.search.candidates import Candidates, SearchSettings, evidence_at, refine
from model.search.hypotheses import KINDS, Hypotheses, is_among, within
from model.search.hypothesise import (
    HypothesisSettings,
    Start,
    flip_start,
    grid_start,
    hypothesise,
    matched_start,
)

__all__ = [
    "KINDS",
    "Candidates",
    "Hypotheses",
    "HypothesisSettings",
    "SearchSettings",
    "Start",
    "evidence_at",
    "flip_start",
    "grid_start",
    "hypothesise",
    "is_among",
    "matched_start",
    "refine",
    "within",
]
