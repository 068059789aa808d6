"""Which candidate is right, and how likely."""

from model.verification.evidence import NAMES, Evidence
from model.verification.examination import Examination
from model.verification.verifier import Verifier, surface_agreement

__all__ = ["NAMES", "Evidence", "Examination", "Verifier", "surface_agreement"]
