"""Which candidate is right, and how likely."""

from model.verification.evidence import NAMES, Evidence
from model.verification.verifier import Verifier, surface_agreement

__all__ = ["NAMES", "Evidence", "Verifier", "surface_agreement"]
