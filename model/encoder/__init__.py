"""Encoders φ: (B, N, 3) points → (B, N, 3, C) steerable features, chosen by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import nn

from model.encoder.vn_dgcnn import VNDgcnn
from model.encoder.vn_graph import VNGraph
from model.encoder.vn_scales import VNScales
from model.exceptions import InvalidOptionError

ENCODERS: dict[str, Callable[..., nn.Module]] = {
    "vn_graph": VNGraph,
    "vn_scales": VNScales,
    "vn_dgcnn": VNDgcnn,
}


def build_encoder(name: str, **architecture: Any) -> nn.Module:
    """Build an encoder with fresh weights.

    Args:
        name: one of ``ENCODERS``.
        architecture: the encoder's own arguments.

    Raises:
        InvalidOptionError: no encoder of this name, or an argument it doesn't have.
    """
    if name not in ENCODERS:
        raise InvalidOptionError(
            "unknown encoder",
            field="encoder.name",
            value=name,
            mend=f"choose one of {', '.join(ENCODERS)}",
        )
    try:
        return ENCODERS[name](**architecture)
    except TypeError as error:
        raise InvalidOptionError(
            f"{name} can't be built: {error}",
            field="encoder",
            value=architecture,
            mend="see the encoder's arguments",
        ) from None


__all__ = ["ENCODERS", "VNDgcnn", "VNGraph", "VNScales", "build_encoder"]
