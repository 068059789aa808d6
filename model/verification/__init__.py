"""Which candidate is right, and how likely."""

from model.verification.evidence import NAMES, Evidence
from model.verification.examination import Examination
from model.verification.verifier import Judge, SurfaceAgreement, Verifier

__all__ = ["NAMES", "Evidence", "Examination", "Judge", "SurfaceAgreement", "Verifier"]
