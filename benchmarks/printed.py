"""Figures as the paper prints them, for methods that can't be run here and for comparison.

They were measured by its authors on ModelNet40 and ETH3D, on their machines and by their code; its
RANSAC and FGR rows are of misused baselines (estimated scale, a failure counted as the identity).
"""

from __future__ import annotations

from dataclasses import dataclass

SOURCE = "EquivAlign, ECCV 2024, tables 1 and 2"
ABLATION_SOURCE = "EquivAlign, ECCV 2024, table 3"
MARK = "(printed)"

_COLUMNS = ("clean", "noise", "outliers", "crop5", "crop10", "crop20")

# Mean rotation error in degrees: six columns at 45°, six at 90°.
_OBJECTS = {
    "ICP": (1.11, 1.21, 1.38, 2.25, 2.73, 5.94, 34.52, 36.15, 38.00, 37.00, 39.23, 45.04),
    "GICP": (2.44, 2.74, 2.53, 3.33, 3.34, 5.68, 49.88, 46.42, 48.40, 49.28, 49.90, 53.78),
    "Geometric-CVO": (
        *(5.67, 5.93, 6.28, 11.04, 15.90, 23.40),
        *(23.90, 26.92, 30.84, 31.77, 45.24, 52.47),
    ),
    "FPFH + RANSAC": (
        *(0.02, 42.50, 42.43, 42.56, 42.37, 43.10),
        *(0.73, 85.63, 85.60, 85.60, 85.51, 85.17),
    ),
    "FPFH + FGR": (
        *(0.07, 2.27, 12.62, 37.93, 44.73, 57.15),
        *(0.14, 11.69, 43.88, 78.66, 82.22, 90.94),
    ),
    "GeoTransformer": (
        *(0.67, 0.71, 0.92, 1.13, 1.22, 1.39),
        *(42.82, 43.28, 42.58, 41.41, 42.04, 45.45),
    ),
    "E2PN": (
        *(3.86, 46.84, 70.88, 76.90, 84.30, 92.41),
        *(3.78, 48.19, 70.61, 76.06, 83.42, 94.70),
    ),
    "EquivAlign": (
        *(0.61, 1.93, 1.96, 9.88, 14.23, 19.20),
        *(1.14, 4.08, 4.12, 15.01, 28.87, 43.32),
    ),
}


@dataclass(frozen=True, slots=True)
class PrintedFrames:
    """A row of the paper's table on ETH3D; degrees and metres, None where it has no figure."""

    method: str
    rotation_mean: float
    rotation_std: float | None
    translation_mean: float | None
    translation_std: float | None


FRAMES = (
    PrintedFrames("ICP", 0.88, 1.30, 0.03, 0.05),
    PrintedFrames("GICP", 0.69, 3.54, 0.02, 0.11),
    PrintedFrames("Geometric-CVO", 0.71, 0.94, 0.02, 0.02),
    PrintedFrames("FPFH + RANSAC", 8.75, 2.95, 0.17, 0.40),
    PrintedFrames("FPFH + FGR", 3.60, 12.61, 0.08, 0.17),
    PrintedFrames("GeoTransformer", 2.23, 13.09, 0.07, 0.31),
    PrintedFrames("E2PN", 5.20, None, None, None),
    PrintedFrames("EquivAlign", 0.53, 0.99, 0.01, 0.02),
)


@dataclass(frozen=True, slots=True)
class PrintedAblation:
    """A row of the paper's ablations, rotation errors in degrees; None where it has no figure."""

    name: str
    mean: float
    std: float | None


# By study. Its study of lengthscales is drawn, not printed.
ABLATIONS = {
    "kernel": (
        PrintedAblation("RBF × tanh", 0.29, None),
        PrintedAblation("RBF only, on the direct sum", 81.97, None),
    ),
    "curriculum": (
        PrintedAblation("1, 10, 20, 30, 45°", 0.29, 0.469),
        PrintedAblation("45° directly", 2.73, 9.1),
    ),
}


def printed_rotation(method: str, turn: str, column: str) -> float | None:
    """Mean rotation error that the paper prints, or None where it has none."""
    if turn not in ("45", "90") or column not in _COLUMNS:
        return None
    return _OBJECTS[method][_COLUMNS.index(column) + (len(_COLUMNS) if turn == "90" else 0)]


def printed_methods() -> list[str]:
    """Those in the paper's table on ModelNet40."""
    return list(_OBJECTS)
