"""Protocols of the object benchmark: what happens to the clouds, and how far they are turned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

from model.exceptions import InvalidOptionError
from training.data.motion import Motion
from training.data.perturbation import CropRule, Perturbation

ProtocolName = Literal["paper", "full", "hard"]
Sampler = Literal["axis-angle", "official"]

PAPER_ANGLES = (45.0, 90.0)

_SIGMA = (0.01, 0.01)
_OUTLIER_SHARE = (0.2, 0.2)
_POINTS = (1024, 1024)
_HARD_SIZES = (600, 1400)
_HARD_CROP = (0.2, 0.2)
_FAR = 0.5


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table.

    Attributes:
        name: in options and files.
        title: in tables.
        perturbation: what happens to both clouds.
    """

    name: str
    title: str
    perturbation: Perturbation


@dataclass(frozen=True, slots=True)
class Turn:
    """How far the source is turned away.

    Attributes:
        name: in pair names: ``45``, ``90``, ``so3``.
        title: in tables.
        motion: how the pose is drawn.
    """

    name: str
    title: str
    motion: Motion


@dataclass(frozen=True, slots=True)
class Protocol:
    """Columns × turns; every shape is measured in all of them."""

    name: ProtocolName
    columns: Sequence[Column]
    turns: Sequence[Turn]

    def restricted(self, columns: Sequence[str]) -> Protocol:
        """Some of the columns.

        Raises:
            InvalidOptionError: a column that the protocol hasn't.
        """
        known = {column.name: column for column in self.columns}
        unknown = [name for name in columns if name not in known]
        if unknown:
            raise InvalidOptionError(
                f"the protocol {self.name} has no such column",
                field="columns",
                value=", ".join(unknown),
                mend=f"choose from {', '.join(known)}",
            )
        return replace(self, columns=[known[name] for name in columns])


def build_protocol(
    name: ProtocolName,
    angles: Sequence[float] = PAPER_ANGLES,
    sampler: Sampler = "axis-angle",
    crop_rule: CropRule = "half_space",
    shape_points: int = 4096,
) -> Protocol:
    """Build a protocol (design, section 5).

    Args:
        name: ``paper``: the same 1024 points, turned by the angles about the origin. ``full``: the
            same columns, any rotation, translations up to 0.5. ``hard``: independent samples of
            different sizes, any rotation, translations up to 0.5.
        angles: in degrees, for ``paper``.
        sampler: ``axis-angle`` turns by exactly the angle; ``official`` draws three Euler angles
            below it, as the code released with the paper does. For ``paper``.
        crop_rule: see Perturbation.
        shape_points: dense points a shape, which bound the sizes of independent samples.

    Raises:
        InvalidOptionError: no such protocol, sampler or crop rule, or too few points a shape.
    """
    if name not in get_args(ProtocolName) or sampler not in get_args(Sampler):
        raise InvalidOptionError(
            "no such protocol or sampler",
            field="protocol, sampler",
            value=f"{name}, {sampler}",
            mend=f"use {', '.join(get_args(ProtocolName))}; {', '.join(get_args(Sampler))}",
        )
    if name == "hard":
        columns = _hard_columns(sizes(shape_points), crop_rule)
    else:
        _require_points(shape_points)
        columns = _shared_point_columns(crop_rule)
    turns = [_turn(angle, sampler) for angle in angles] if name == "paper" else [any_turn()]
    return Protocol(name, columns, turns)


def sizes(shape_points: int) -> tuple[int, int]:
    """Least and most points of one of two disjoint samples: 600 to 1400, or in proportion fewer."""
    low, high = _HARD_SIZES
    most = min(high, shape_points // 2)
    return most * low // high, most


def _require_points(shape_points: int) -> None:
    if shape_points < _POINTS[1]:
        raise InvalidOptionError(
            "too few points a shape for this protocol",
            field="data",
            value=f"{shape_points} points",
            mend=f"give shapes of {_POINTS[1]} points or more",
        )


def _turn(angle: float, sampler: Sampler) -> Turn:
    rule: Literal["exact_angle", "official_euler"] = (
        "exact_angle" if sampler == "axis-angle" else "official_euler"
    )
    title = f"{angle:g}°" if sampler == "axis-angle" else f"Euler angles below {angle:g}°"
    return Turn(f"{angle:g}", title, Motion(rule, angle))


def any_turn() -> Turn:
    """Uniform over SO(3), with a translation up to 0.5."""
    return Turn("so3", "all of SO(3)", Motion("haar", 180.0, _FAR))


def _shared_point_columns(crop_rule: CropRule) -> list[Column]:
    same = Perturbation(
        target_points=_POINTS,
        source_points=_POINTS,
        resample_probability=0.0,
        crop_rule=crop_rule,
    )
    noisy = replace(same, sigma=_SIGMA)
    crops = [
        Column(f"crop{percent}", f"crop {percent} %", replace(same, crop_share=(share, share)))
        for percent, share in ((5, 0.05), (10, 0.1), (20, 0.2))
    ]
    return [
        Column("clean", "clean", same),
        Column("noise", "σ = 0.01", noisy),
        Column("outliers", "σ + 20 % outliers", replace(noisy, outlier_share=_OUTLIER_SHARE)),
        *crops,
    ]


def _hard_columns(limits: tuple[int, int], crop_rule: CropRule) -> list[Column]:
    resampled = Perturbation(target_points=limits, source_points=limits, crop_rule=crop_rule)
    noisy = replace(resampled, sigma=_SIGMA, outlier_share=_OUTLIER_SHARE)
    return [
        Column("resampled", "resampled", resampled),
        Column("noisy", "resampled + σ + outliers", noisy),
        Column("cropped", "resampled + crop 20 %", replace(resampled, crop_share=_HARD_CROP)),
        Column("all", "all together", replace(noisy, crop_share=_HARD_CROP)),
    ]
