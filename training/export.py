"""From a Lightning checkpoint to an artifact that can be served."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from model.artifact import Artifact, save_artifact
from model.exceptions import ArtifactFormatError, ArtifactNotFoundError
from model.settings import RegistrarSettings

_PREFIX = "encoder."


def export(checkpoint: Path, directory: Path, name: str | None = None) -> Artifact:
    """Write the encoder of a checkpoint as an artifact.

    Args:
        checkpoint: written by ``fit``. Only tensors and plain values are read from it.
        directory: of the artifact.
        name: of the artifact; the directory's name when left out.

    Raises:
        ArtifactNotFoundError: no checkpoint there.
        ArtifactFormatError: not a checkpoint of ``fit``.
        ArtifactError: the directory can't be written.
    """
    state = _read(checkpoint)
    made = state["equivalign"]
    weights = {
        key.removeprefix(_PREFIX): value
        for key, value in state["state_dict"].items()
        if key.startswith(_PREFIX)
    }
    artifact = Artifact(
        name=name or directory.resolve().name,
        encoder_name=made["encoder"],
        architecture=made["architecture"],
        kernel=made["kernel"],
        settings=RegistrarSettings(),
        training=_summary(state),
        weights=weights,
    )
    artifact.encoder()
    save_artifact(artifact, directory)
    return artifact


def _read(checkpoint: Path) -> dict[str, Any]:
    if not checkpoint.is_file():
        raise ArtifactNotFoundError(
            "no such checkpoint",
            field="checkpoint",
            value=checkpoint,
            mend="give a .ckpt file that `equivalign fit` wrote",
        )
    try:
        state = torch.load(checkpoint, map_location="cpu", weights_only=True)
        if not {"equivalign", "state_dict", "global_step"} <= set(state):
            raise KeyError("entries are missing")
    except Exception as error:  # torch.load raises many kinds for a foreign file
        raise ArtifactFormatError(
            f"not a checkpoint of `equivalign fit`: {str(error).splitlines()[0]}",
            field="checkpoint",
            value=checkpoint,
            mend="give a .ckpt file that `equivalign fit` wrote",
        ) from None
    return dict(state)


def _summary(state: Mapping[str, Any]) -> dict[str, Any]:
    made = state["equivalign"]
    kept = (
        "loss",
        "transforms_used",
        "inner_loop",
        "backward",
        "curriculum_angles",
        "curriculum_stage",
        "seed",
    )
    return {
        "steps": state["global_step"],
        "epochs": state["epoch"],
        "pose_labels": "none: no human or sensor pose is used",
        **{key: made[key] for key in kept},
    }


def export_command(argv: list[str]) -> int:
    """Turn a checkpoint into an artifact that can be served."""
    parser = argparse.ArgumentParser(prog="equivalign export", description=export_command.__doc__)
    parser.add_argument("checkpoint", type=Path, help="a .ckpt file that fit wrote")
    parser.add_argument("directory", type=Path, help="where the artifact goes")
    parser.add_argument("--name", help="the artifact's name; the directory's when left out")
    arguments = parser.parse_args(argv)
    artifact = export(arguments.checkpoint, arguments.directory, arguments.name)
    print(f"{arguments.directory}: {artifact.encoder_name}, {artifact.training['steps']} steps")
    return 0
