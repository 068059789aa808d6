"""What a training begins with: an encoder without training, or that of an artifact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import nn

from model.artifact import DEFAULT_NAME, load_artifact
from model.encoder import build_encoder


@dataclass(frozen=True)
class Beginning:
    """An encoder and what describes it.

    Attributes:
        encoder_name: see ``model.encoder.ENCODERS``.
        architecture: the encoder's arguments.
        kernel: name of the feature kernel.
        encoder: in training mode.
    """

    encoder_name: str
    architecture: dict[str, Any]
    kernel: str
    encoder: nn.Module

    @classmethod
    def of(
        cls, encoder: str, architecture: Mapping[str, Any], kernel: str, initial: str | None
    ) -> Beginning:
        """A new encoder by its name, or where ``initial`` names an artifact, the one in it.

        Raises:
            ArtifactError: the artifact can't be loaded.
            InvalidOptionError: no such encoder.
        """
        if initial is None:
            made = build_encoder(encoder, **architecture)
            return cls(encoder, dict(architecture), kernel, made)
        artifact = load_artifact(None if initial == DEFAULT_NAME else initial)
        return cls(
            artifact.encoder_name,
            dict(artifact.architecture),
            artifact.kernel,
            artifact.encoder().train(),
        )
