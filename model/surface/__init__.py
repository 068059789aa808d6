"""The surface kernel: the paper's kernel with a metric that knows which way the surface faces."""

from model.surface.arrays import SurfaceArrays
from model.surface.cells import Cells, cells_of
from model.surface.cloud import CellView, SurfaceCloud, nearest_others
from model.surface.curvature import SurfaceCurvature, surface_curvature
from model.surface.descent import Descent, descend
from model.surface.meeting import Meeting
from model.surface.moments import REACH, VIEW, SurfaceMoments, surface_moments
from model.surface.near_pairs import NearPairs, near_pairs
from model.surface.newton import newton_polish
from model.surface.overlap import overlapping
from model.surface.patches import Correct, Patches, surface_spacing
from model.surface.product import surface_product, surface_products
from model.surface.solver import SurfaceLoop, SurfaceSolution
from model.surface.together import CorrectPair

__all__ = [
    "REACH",
    "VIEW",
    "CellView",
    "Cells",
    "Correct",
    "CorrectPair",
    "Descent",
    "Meeting",
    "NearPairs",
    "Patches",
    "SurfaceArrays",
    "SurfaceCloud",
    "SurfaceCurvature",
    "SurfaceLoop",
    "SurfaceMoments",
    "SurfaceSolution",
    "cells_of",
    "descend",
    "near_pairs",
    "nearest_others",
    "newton_polish",
    "overlapping",
    "surface_curvature",
    "surface_moments",
    "surface_product",
    "surface_products",
    "surface_spacing",
]
