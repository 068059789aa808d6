"""Which candidate is right, and how likely."""

from model.verification.agreement import surface_share
from model.verification.contact import edges
from model.verification.evidence import NAMES, Evidence
from model.verification.examination import Examination
from model.verification.verifier import Judge, Perceptron, SurfaceAgreement, Verifier

__all__ = [
    "NAMES",
    "Evidence",
    "Examination",
    "Judge",
    "Perceptron",
    "SurfaceAgreement",
    "Verifier",
    "edges",
    "surface_share",
]
