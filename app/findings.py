"""A registration's answer in words, for people."""

from __future__ import annotations

from collections.abc import Iterable

from model import Diagnostics, RegistrationResult


def pose_lines(result: RegistrationResult) -> list[tuple[str, str]]:
    """The pose as (name, text): rotations to seven places, lengths to twelve digits."""
    matrix = (
        _rotation_numbers(row[:3]) + _length(row[3]) for row in result.T_target_source.tolist()
    )
    return [
        ("T_target_source", "\n".join(matrix)),
        ("Quaternion x y z w", _rotation_numbers(result.quaternion_xyzw.tolist())),
        ("Translation", "".join(map(_length, result.translation.tolist()))),
    ]


def findings(diagnostics: Diagnostics) -> list[tuple[str, str]]:
    """What the diagnostics say, as (subject, statement) in the order of interest."""
    d = diagnostics
    rmse = (
        "no source point has one that near"
        if d.inlier_rmse is None
        else f"{d.inlier_rmse:.4g} away (root mean square)"
    )
    ended = "converged" if d.converged else "stopped before it converged"
    stages = ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in d.seconds.items())
    return [
        ("Similarity ρ", f"{d.similarity:.4f} (1 for equal functions)"),
        ("RKHS distance d", f"{d.rkhs_distance:.4g}"),
        ("Lengthscale ℓ", f"{d.lengthscale:.4g}"),
        (
            "Overlap",
            f"{d.overlap_source:.0%} of the source, {d.overlap_target:.0%} of the target "
            f"(a neighbour within {d.inlier_distance:.4g})",
        ),
        ("Nearest neighbour", rmse),
        ("Inner loop", f"{d.solver}, {ended} after {d.iterations} iterations"),
        ("Search", f"{d.hypotheses} start poses; the answer came from: {d.won_by}"),
        ("Points used", f"{d.points_source} source, {d.points_target} target"),
        ("Seconds", stages),
        *(("Warning", warning) for warning in d.warnings),
    ]


def _rotation_numbers(numbers: Iterable[float]) -> str:
    return "".join(f"{number:>11.7f}" for number in numbers)


def _length(number: float) -> str:
    return f"{number:>18.12g}"
