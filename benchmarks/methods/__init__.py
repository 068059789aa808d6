"""The methods that a benchmark compares, chosen by name."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import import_module

from benchmarks.methods.method import Answer, Method
from model.artifact import load_artifact
from model.exceptions import InvalidOptionError

# Where each class, or what builds it, is; imported only when asked for: they bring large libraries.
_OTHERS = {
    "icp": ("benchmarks.methods.icp", "OpenIcp"),
    "gicp": ("benchmarks.methods.icp", "OpenGicp"),
    "small_gicp": ("benchmarks.methods.small_gicp", "SmallGicp"),
    "geometric_cvo": ("benchmarks.methods.geometric_cvo", "geometric_cvo"),
    "identity": ("benchmarks.methods.identity", "Identity"),
    "ransac": ("benchmarks.methods.fpfh", "FpfhRansac"),
    "ransac_3": ("benchmarks.methods.fpfh", "ransac_of_three"),
    "fgr": ("benchmarks.methods.fpfh", "FpfhFgr"),
    "kiss_matcher": ("benchmarks.methods.kiss_matcher", "KissMatcher"),
}
OUR_NAMES = (
    "ours",
    "ours_procrustes",
    "ours_gradient",
    "ours_no_features",
    "ours_random_encoder",
    "ours_paper_bilevel",
)
# Packages that only one method needs, and that nobody has to install.
_OPTIONAL = {"small_gicp", "kiss_matcher"}

METHOD_NAMES = (*OUR_NAMES, *_OTHERS)


@dataclass(frozen=True, slots=True)
class Field:
    """The methods that take part.

    Attributes:
        methods: in the order asked for.
        absent: why the others can't take part, a line each.
    """

    methods: list[Method] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)


def build_methods(names: Iterable[str], artifact: str | None = None) -> Field:
    """Build methods by name.

    Args:
        names: of ``METHOD_NAMES``.
        artifact: directory or name of our artifact; None for the shipped one.

    Raises:
        InvalidOptionError: no such method.
        ArtifactError: the artifact can't be loaded.
    """
    names = list(names)
    unknown = [name for name in names if name not in METHOD_NAMES]
    if unknown:
        raise InvalidOptionError(
            "no such method",
            field="methods",
            value=", ".join(unknown),
            mend=f"choose from {', '.join(METHOD_NAMES)}",
        )
    found = Field()
    for name in names:
        try:
            found.methods.append(_build(name, artifact))
        except ModuleNotFoundError as error:
            if error.name not in _OPTIONAL:
                raise
            found.absent.append(f"{name} is left out: the package {error.name} isn't installed")
    return found


def _build(name: str, artifact: str | None) -> Method:
    if name in OUR_NAMES:
        from benchmarks.methods.equivalign import VARIANTS

        return VARIANTS[name](load_artifact(artifact))
    module, kind = _OTHERS[name]
    method: Method = getattr(import_module(module), kind)()
    return method


__all__ = ["METHOD_NAMES", "OUR_NAMES", "Answer", "Field", "Method", "build_methods"]
