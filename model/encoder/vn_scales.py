"""Two looks at one cloud: features of wide balls and features of balls that end soon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from model.encoder.vn_graph import VNGraph
from model.exceptions import InvalidOptionError

_WIDE_AND_SMALL: tuple[Mapping[str, Any], ...] = (
    {"profile": "gaussian", "radii": (0.08, 0.16, 0.32)},
    {"profile": "compact", "radii": (0.15, 0.3, 0.5)},
)


class VNScales(nn.Module):
    """Several ``VNGraph``s side by side; the features are their channels one after another.

    Wide balls give features that survive resampling and noise, but a crop changes them; small ones
    survive the crop, but not the resampling. The search matches each group of channels by itself
    and lets the matches of all groups vote.

    Args:
        scales: arguments of each ``VNGraph`` that differ from the common ones.
        **common: arguments of all; ``channels_out`` is that of each.

    Raises:
        InvalidOptionError: no scale, or scales of different ``channels_out``.
    """

    def __init__(
        self, scales: Sequence[Mapping[str, Any]] = _WIDE_AND_SMALL, **common: Any
    ) -> None:
        super().__init__()
        graphs = [VNGraph(**{**common, **scale}) for scale in scales]
        widths = {graph.channels_out for graph in graphs}
        if len(widths) != 1:
            raise InvalidOptionError(
                "every scale must have the same number of output channels",
                field="encoder.scales",
                value=sorted(widths),
                mend="give at least one scale, and channels_out once",
            )
        self.scales = nn.ModuleList(graphs)
        self.groups = len(graphs)
        self.channels_out = self.groups * widths.pop()

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        """(B, N, 3) points and optional (B, N) mask → (B, N, 3, C)."""
        return torch.cat([scale(x, mask) for scale in self.scales], -1)
