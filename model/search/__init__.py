"""Global search: start poses, and the few of them worth solving."""

from model.search.candidates import Candidates, SearchSettings, refine
from model.search.consensus import support_of
from model.search.hypotheses import KINDS, Hypotheses, is_among, within
from model.search.hypothesise import (
    HypothesisSettings,
    Start,
    flip_start,
    given_start,
    grid_start,
    hypothesise,
    matched_start,
    slide_start,
)

__all__ = [
    "KINDS",
    "Candidates",
    "Hypotheses",
    "HypothesisSettings",
    "SearchSettings",
    "Start",
    "flip_start",
    "given_start",
    "grid_start",
    "hypothesise",
    "is_among",
    "matched_start",
    "refine",
    "slide_start",
    "support_of",
    "within",
]
