"""Small trainings by committed configurations; each is done once and goes on where it stopped."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from benchmarks.folder import make_folder
from model.artifact import DESCRIPTION_FILE, Artifact, load_artifact
from model.exceptions import EquivAlignError, InvalidOptionError, UnreadableFileError

CONFIGS = Path(__file__).resolve().parents[2] / "configs" / "ablations"


@dataclass(frozen=True, slots=True)
class Recipe:
    """A training.

    Attributes:
        name: of its folder and its artifact.
        configs: names of configuration files, later ones overriding earlier ones.
    """

    name: str
    configs: Sequence[str]

    @property
    def note(self) -> str:
        """What the tables say about where the weights come from."""
        return "trained by " + " + ".join(f"{config}.yaml" for config in self.configs)


@dataclass(frozen=True, slots=True)
class Workshop:
    """Where trainings are run and kept.

    Attributes:
        runs: a folder a training below it; made where it isn't there.
        configs: folder of the configurations.
        steps: optimiser steps instead of the configurations' own; None keeps these.
    """

    runs: Path
    configs: Path = CONFIGS
    steps: int | None = None

    def artifact(self, recipe: Recipe) -> Artifact:
        """Train, or take what an earlier run of the same configuration has trained.

        Args:
            recipe: what to train.

        Raises:
            UnreadableFileError: a configuration isn't there.
            InvalidOptionError: the training failed; its output is in ``training.log``.
        """
        place = self.place(recipe)
        if not (place / "artifact" / DESCRIPTION_FILE).is_file():
            self._train(recipe, place)
            self._export(recipe, place)
        return load_artifact(place / "artifact")

    def place(self, recipe: Recipe) -> Path:
        """Its folder; another one as soon as any of its configurations changes."""
        digest = hashlib.sha256(f"steps {self.steps}".encode())
        for path in self._paths(recipe):
            try:
                digest.update(path.read_bytes())
            except OSError as error:
                raise UnreadableFileError(
                    f"the configuration can't be read: {error.strerror}",
                    field="configs",
                    value=path,
                    mend="run this in a checkout, or give the folder with --configs",
                ) from error
        return self.runs / f"{recipe.name}-{digest.hexdigest()[:8]}"

    def _paths(self, recipe: Recipe) -> list[Path]:
        return [self.configs / f"{config}.yaml" for config in recipe.configs]

    def _train(self, recipe: Recipe, place: Path) -> None:
        command = [sys.executable, "-m", "training", "fit"]
        for path in self._paths(recipe):
            command += ["-c", str(path)]
        command.append(f"--trainer.default_root_dir={place}")
        if self.steps is not None:
            command.append(f"--trainer.max_steps={self.steps}")
        last = _last_checkpoint(place)
        if last is not None:
            command.append(f"--ckpt_path={last}")
        log = make_folder(place, "runs") / "training.log"
        Console().print(f"{recipe.name}: {recipe.note}; {log}", soft_wrap=True, highlight=False)
        # A process of its own: a training sets seeds, threads and warnings for all of it.
        with log.open("a") as stream:
            done = subprocess.run(command, stdout=stream, stderr=stream, check=False)
        if done.returncode != 0:
            raise InvalidOptionError(
                f"the training failed: {_last_line(log)}",
                field="configs",
                value=recipe.name,
                mend=f"see {log}; the same command goes on where it stopped",
            )

    def _export(self, recipe: Recipe, place: Path) -> None:
        from training.export import export

        last = _last_checkpoint(place)
        if last is None:
            raise EquivAlignError("the training left no checkpoint", field="runs", value=place)
        export(last, place / "artifact", recipe.name)


def _last_line(log: Path) -> str:
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it said nothing"


def _last_checkpoint(place: Path) -> Path | None:
    found = sorted(place.rglob("last.ckpt"), key=lambda path: path.stat().st_mtime)
    return found[-1] if found else None
