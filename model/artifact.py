"""The trained artifact: a directory with ``encoder.safetensors`` and ``artifact.json``."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor, nn

from model.encoder import build_encoder
from model.exceptions import (
    ArtifactError,
    ArtifactFormatError,
    ArtifactIntegrityError,
    ArtifactNotFoundError,
    InvalidOptionError,
)
from model.kernel import feature_kernel
from model.normals import NormalNetwork
from model.settings import RegistrarSettings
from model.verification import Verifier

FORMAT_VERSION = 1
WEIGHTS_FILE = "encoder.safetensors"
DESCRIPTION_FILE = "artifact.json"
SHIPPED = Path(__file__).parent / "artifacts"
DEFAULT_NAME = "default"
# Of the normal networks' tensors, which share the weights file with the encoder's.
_PREFIXES = {"normals": "normals.", "pair_normals": "pair_normals."}

_REQUIRED = ("format_version", "name", "encoder", "kernel", "solver", "training", "weights_sha256")


@dataclass(frozen=True, slots=True)
class Artifact:
    """A trained encoder and all that is needed to register with it.

    Attributes:
        name: of the artifact.
        encoder_name: see ``model.encoder.ENCODERS``.
        architecture: the encoder's arguments.
        kernel: name of the feature kernel.
        settings: solver defaults.
        training: summary of how the weights came about.
        weights: the encoder's state.
        weights_sha256: of the weights file; empty until written.
        verifier: judges candidates and gives the probability; None until one is fitted.
        normals: corrects fitted normals; None until it is trained.
        pair_normals: does so for two clouds that meet, and weighs their points; None until it is
            trained.
    """

    name: str
    encoder_name: str
    architecture: Mapping[str, Any]
    kernel: str
    settings: RegistrarSettings
    training: Mapping[str, Any]
    weights: Mapping[str, Tensor]
    weights_sha256: str = field(default="")
    verifier: Verifier | None = None
    normals: NormalNetwork | None = None
    pair_normals: NormalNetwork | None = None

    @property
    def learned_normals(self) -> tuple[NormalNetwork | None, NormalNetwork | None]:
        """The networks for clouds by themselves and for pairs; none where they are switched off.

        Without one of its own a pair gets the one for clouds.
        """
        if not self.settings.learned_normals:
            return None, None
        return self.normals, self.pair_normals or self.normals

    def encoder(self) -> nn.Module:
        """The encoder with its weights, in evaluation mode.

        Raises:
            ArtifactFormatError: the weights don't fit the architecture.
        """
        try:
            encoder = build_encoder(self.encoder_name, **self.architecture)
            encoder.load_state_dict(dict(self.weights), strict=True)
        except (InvalidOptionError, RuntimeError) as error:
            raise ArtifactFormatError(
                "the weights don't fit the architecture",
                field=WEIGHTS_FILE,
                value=str(error).splitlines()[0],
                mend="export the checkpoint again",
            ) from None
        return encoder.eval()

    def description(self) -> dict[str, Any]:
        """What ``artifact.json`` holds."""
        return {
            "format_version": FORMAT_VERSION,
            "name": self.name,
            "encoder": {"name": self.encoder_name, "architecture": dict(self.architecture)},
            "kernel": {"feature": self.kernel},
            "solver": self.settings.as_dict(),
            "verifier": None if self.verifier is None else self.verifier.as_dict(),
            **{
                name: None if network is None else network.architecture
                for name, network in _networks(self).items()
            },
            "training": dict(self.training),
            "weights_sha256": self.weights_sha256,
        }


def save_artifact(artifact: Artifact, directory: Path) -> None:
    """Write an artifact; the directory appears whole or not at all.

    An artifact that is already there is replaced.

    Raises:
        ArtifactError: the place can't be written, or holds something else.
    """
    directory = directory.resolve()
    if directory.exists() and not _is_artifact_or_empty(directory):
        raise ArtifactError(
            "the directory holds something that isn't an artifact",
            field="directory",
            value=directory,
            mend="choose another directory",
        )
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        staged = Path(tempfile.mkdtemp(prefix=f".{directory.name}-", dir=directory.parent))
        try:
            _write(artifact, staged)
            staged.chmod(0o755)
            if directory.exists():
                shutil.rmtree(directory)
            os.replace(staged, directory)
        finally:
            shutil.rmtree(staged, ignore_errors=True)
    except OSError as error:
        raise ArtifactError(
            f"the artifact can't be written: {error.strerror}",
            field="directory",
            value=directory,
            mend="choose a directory that can be written",
        ) from None


def _is_artifact_or_empty(directory: Path) -> bool:
    return directory.is_dir() and {p.name for p in directory.iterdir()} <= {
        WEIGHTS_FILE,
        DESCRIPTION_FILE,
    }


def _write(artifact: Artifact, directory: Path) -> None:
    weighed = dict(artifact.weights)
    for name, network in _networks(artifact).items():
        if network is not None:
            weighed |= {_PREFIXES[name] + k: w for k, w in network.state_dict().items()}
    tensors = {name: w.detach().contiguous().cpu() for name, w in weighed.items()}
    weights = safetensors.torch.save(tensors)
    description = artifact.description()
    description["weights_sha256"] = hashlib.sha256(weights).hexdigest()
    (directory / WEIGHTS_FILE).write_bytes(weights)
    (directory / DESCRIPTION_FILE).write_text(json.dumps(description, indent=2) + "\n")


def load_artifact(place: Path | str | None = None) -> Artifact:
    """Read an artifact without unpickling anything.

    Args:
        place: its directory; the name of a shipped artifact; None for the shipped default.

    Raises:
        ArtifactNotFoundError: nothing there.
        ArtifactFormatError: a key is missing, or the version is unknown.
        ArtifactIntegrityError: the weights' SHA-256 isn't the one described.
    """
    directory = _locate(place)
    description = _read_description(directory / DESCRIPTION_FILE)
    weights = _read_weights(directory / WEIGHTS_FILE, description["weights_sha256"])
    prefixes = tuple(_PREFIXES.values())
    try:
        return Artifact(
            name=str(description["name"]),
            encoder_name=description["encoder"]["name"],
            architecture=description["encoder"]["architecture"],
            kernel=feature_kernel(description["kernel"]["feature"]).name,
            settings=RegistrarSettings.from_dict(description["solver"]),
            training=description["training"],
            weights={k: w for k, w in weights.items() if not k.startswith(prefixes)},
            weights_sha256=description["weights_sha256"],
            verifier=_verifier(description.get("verifier")),
            **{
                name: _normals(description.get(name), prefix, weights)
                for name, prefix in _PREFIXES.items()
            },
        )
    except (KeyError, TypeError, InvalidOptionError, RuntimeError) as error:
        raise ArtifactFormatError(
            f"an entry is missing or wrong: {error}",
            field=DESCRIPTION_FILE,
            value=directory,
            mend="export the checkpoint again",
        ) from None


def _verifier(plain: Mapping[str, Any] | None) -> Verifier | None:
    return None if plain is None else Verifier.from_dict(plain)


def _networks(artifact: Artifact) -> dict[str, NormalNetwork | None]:
    return {"normals": artifact.normals, "pair_normals": artifact.pair_normals}


def _normals(
    architecture: Mapping[str, Any] | None, prefix: str, weights: Mapping[str, Tensor]
) -> NormalNetwork | None:
    if architecture is None:
        return None
    network = NormalNetwork(**architecture)
    mine = {k: w for k, w in weights.items() if k.startswith(prefix)}
    network.load_state_dict({k.removeprefix(prefix): w for k, w in mine.items()})
    return network.requires_grad_(False).eval()


def _locate(place: Path | str | None) -> Path:
    directory = SHIPPED / DEFAULT_NAME if place is None else Path(place)
    shipped = SHIPPED / str(place)
    if not directory.exists() and isinstance(place, str) and "/" not in place and shipped.is_dir():
        directory = shipped
    for name in (DESCRIPTION_FILE, WEIGHTS_FILE):
        if not (directory / name).is_file():
            raise ArtifactNotFoundError(
                f"no artifact here: {name} is missing",
                field="artifact",
                value=str(place or directory),
                mend="give a directory written by `equivalign export`",
            )
    return directory


def _read_description(path: Path) -> dict[str, Any]:
    try:
        description = json.loads(path.read_text())
    except (ValueError, UnicodeDecodeError):
        raise ArtifactFormatError(
            "the description isn't valid JSON",
            field=DESCRIPTION_FILE,
            value=path,
            mend="export the checkpoint again",
        ) from None
    if not isinstance(description, dict):
        raise ArtifactFormatError(
            "the description isn't a JSON object",
            field=DESCRIPTION_FILE,
            value=path,
            mend="export the checkpoint again",
        )
    missing = [key for key in _REQUIRED if key not in description]
    if missing:
        raise ArtifactFormatError(
            f"missing: {', '.join(missing)}",
            field=DESCRIPTION_FILE,
            value=path,
            mend="export the checkpoint again",
        )
    if description["format_version"] != FORMAT_VERSION:
        raise ArtifactFormatError(
            f"unknown format version; this program reads version {FORMAT_VERSION}",
            field="format_version",
            value=description["format_version"],
            mend="export the checkpoint again, or update this program",
        )
    return description


def _read_weights(path: Path, sha256: str) -> dict[str, Tensor]:
    raw = path.read_bytes()
    found = hashlib.sha256(raw).hexdigest()
    if found != sha256:
        raise ArtifactIntegrityError(
            "the weights aren't those that the description was written for",
            field=WEIGHTS_FILE,
            value=f"SHA-256 {found[:12]}…, not {str(sha256)[:12]}…",
            mend="export the checkpoint again, or copy both files together",
        )
    try:
        return safetensors.torch.load(raw)
    except safetensors.SafetensorError:
        raise ArtifactIntegrityError(
            "the weights file isn't in the safetensors format",
            field=WEIGHTS_FILE,
            value=path,
            mend="export the checkpoint again",
        ) from None
