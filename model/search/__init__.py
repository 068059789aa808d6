"""Global search: start poses, and the few of them worth solving."""

from model.search.candidates import Candidates, SearchSettings, refine
from model.search.consensus import support_of
from model.search.flips import flipped_poses
from model.search.hypotheses import KINDS, Hypotheses, is_among, turned_apart, within
from model.search.hypothesise import (
    HypothesisSettings,
    Start,
    given_start,
    grid_start,
    hypothesise,
    matched_start,
    varied_start,
)
from model.search.shifts import shifted_poses
from model.search.slides import FEWEST, NUDGES, Holding, slid_poses

__all__ = [
    "FEWEST",
    "KINDS",
    "NUDGES",
    "Candidates",
    "Holding",
    "Hypotheses",
    "HypothesisSettings",
    "SearchSettings",
    "Start",
    "flipped_poses",
    "given_start",
    "grid_start",
    "hypothesise",
    "is_among",
    "matched_start",
    "refine",
    "shifted_poses",
    "slid_poses",
    "support_of",
    "turned_apart",
    "varied_start",
    "within",
]
