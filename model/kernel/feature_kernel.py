"""κ(s) on the steerable features, s = f·g summed over channels (paper, section 4.3).

Each kernel gives κ, its slope and its curvature, from which the inner loops build closed-form
steps and the Newton polish its Hessian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from model.exceptions import InvalidOptionError


@dataclass(frozen=True, slots=True)
class FeatureKernel:
    """A kernel on feature inner products.

    Attributes:
        name: its name in configurations and artifacts.
        evaluate: s → (κ(s), κ'(s), κ''(s)), elementwise.
        cosine: whether s is the cosine of the two features rather than their inner product.
    """

    name: str
    evaluate: Callable[[Tensor], tuple[Tensor, Tensor, Tensor]]
    cosine: bool = False


def _tanh(s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    value = torch.tanh(1.0 + s)
    slope = 1.0 - value * value
    return value, slope, -2.0 * value * slope


def _tanh_cosine(s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    value = torch.tanh(s)
    slope = 1.0 - value * value
    return 1.0 + value, slope, -2.0 * value * slope


def _exponential(s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    value = torch.exp(s)
    return value, value, value


def _constant(s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return torch.ones_like(s), torch.zeros_like(s), torch.zeros_like(s)


FEATURE_KERNELS: dict[str, FeatureKernel] = {
    kernel.name: kernel
    for kernel in (
        FeatureKernel("tanh", _tanh),  # the paper's tanh(1 + f·g)
        FeatureKernel("tanh_cosine", _tanh_cosine, cosine=True),  # the released code's
        FeatureKernel("exponential", _exponential),  # positive definite
        FeatureKernel("none", _constant),  # RBF only, the paper's ablation (a)
    )
}


def feature_kernel(name: str) -> FeatureKernel:
    """Look a feature kernel up by name.

    Raises:
        InvalidOptionError: no kernel of this name.
    """
    try:
        return FEATURE_KERNELS[name]
    except KeyError:
        raise InvalidOptionError(
            "unknown feature kernel",
            field="kernel",
            value=name,
            mend=f"choose one of {', '.join(FEATURE_KERNELS)}",
        ) from None
