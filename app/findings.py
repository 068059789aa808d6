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


# Above and below these the verdict is plain.
_LIKELY, _UNLIKELY = 0.8, 0.4
_LOW_OVERLAP = 0.3
# A runner-up this much like the answer is as good as it.
_AS_GOOD = 0.9


def verdict(diagnostics: Diagnostics) -> str:
    """Whether to trust the pose, in one line."""
    probability = diagnostics.success_probability
    said = _hints(diagnostics) if probability is None else _likelihood(probability)
    return "; ".join([said, *_alternatives(diagnostics)])


def _likelihood(probability: float) -> str:
    words = "likely right" if probability >= _LIKELY else "uncertain"
    return f"{'likely wrong' if probability < _UNLIKELY else words}: {probability:.2f}"


def _hints(d: Diagnostics) -> str:
    overlap = max(d.overlap_source, d.overlap_target)
    shares = f"{d.overlap_source:.0%} and {d.overlap_target:.0%} of the clouds overlap"
    if overlap < _LOW_OVERLAP:
        return f"distrust it: only {shares}"
    if not d.converged:
        return f"with care: {shares}, but the inner loop was still moving"
    return f"plausible: {shares} and the inner loop converged"


def _alternatives(d: Diagnostics) -> list[str]:
    as_good = [other for other in d.runner_ups if other.similarity >= _AS_GOOD * d.similarity]
    angles = ", ".join(f"{other.rotation_from_answer_deg:.0f}°" for other in as_good)
    if not as_good:
        return []
    return [f"{'alternatives' if len(as_good) > 1 else 'alternative'} as good at {angles}"]


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
