"""What an interrupted run leaves behind, so that the same command goes on where it stopped."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.cloud_file import complete_file
from model.exceptions import EquivAlignError, InvalidOptionError, UnreadableFileError
from model.odometry import (
    ConstantVelocity,
    Cycle,
    Keyframe,
    Status,
    Step,
    Tracker,
    VoxelMap,
    read_frame,
)
from model.sequence import FrameSource

FloatArray = npt.NDArray[np.float64]

_MAP = "map_"
# What reading a file that is cut short or of another kind may raise.
_BROKEN = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True, slots=True)
class RunState:
    """A run so far.

    Attributes:
        settings: everything that decides the trajectory, as plain values.
        steps: so far.
        unit: in which the last frame was prepared, or None before the first.
        units: in which the tracker's frames were prepared, by their numbers.
        keyframes: numbers and poses of the tracker's.
        previous: number of the last frame with a pose, or None.
        motion: so far, or None.
        lost_in_a_row: frames lost since the last pose.
        voxels: the map, or None.
    """

    settings: Mapping[str, Any]
    steps: Sequence[Step]
    unit: float | None
    units: Mapping[int, float]
    keyframes: Sequence[tuple[int, FloatArray]]
    previous: tuple[int, FloatArray] | None
    motion: ConstantVelocity | None
    lost_in_a_row: int
    voxels: VoxelMap | None

    @classmethod
    def of(
        cls,
        settings: Mapping[str, Any],
        steps: Sequence[Step],
        unit: float | None,
        tracker: Tracker,
        voxels: VoxelMap | None,
    ) -> RunState:
        """What a tracker needs to go on."""
        kept = [*tracker.keyframes, *([tracker.previous] if tracker.previous else [])]
        previous = tracker.previous
        return cls(
            settings,
            steps,
            unit,
            {keyframe.frame.number: keyframe.frame.cloud.scale for keyframe in kept},
            [(keyframe.frame.number, keyframe.T_world_camera) for keyframe in tracker.keyframes],
            None if previous is None else (previous.frame.number, previous.T_world_camera),
            tracker.motion,
            tracker.lost_in_a_row,
            voxels,
        )

    def write(self, path: Path) -> None:
        """Write it, whole or not at all.

        Raises:
            CloudFileError: the file can't be written there.
        """
        plain = {
            "settings": dict(self.settings),
            "steps": [_plain_step(step) for step in self.steps],
            "unit": self.unit,
            "units": {str(number): unit for number, unit in self.units.items()},
            "keyframes": [[number, T.tolist()] for number, T in self.keyframes],
            "previous": None
            if self.previous is None
            else [self.previous[0], self.previous[1].tolist()],
            "motion": None if self.motion is None else _plain_motion(self.motion),
            "lost_in_a_row": self.lost_in_a_row,
        }
        text = np.frombuffer(json.dumps(plain).encode(), dtype=np.uint8)
        arrays: dict[str, Any] = {"plain": text}
        if self.voxels is not None:
            arrays |= {_MAP + name: array for name, array in self.voxels.state().items()}
        with complete_file(path, "out") as unfinished, unfinished.open("wb") as file:
            np.savez(file, **arrays)

    @classmethod
    def read(cls, path: Path, settings: Mapping[str, Any]) -> RunState | None:
        """The state of an earlier run with the same settings; None where there is no file.

        Raises:
            InvalidOptionError: the earlier run had other settings.
            UnreadableFileError: not such a file.
        """
        if not path.exists():
            return None
        try:
            content = io.BytesIO(path.read_bytes())
            with np.load(content, allow_pickle=False) as archive:
                plain = json.loads(archive["plain"].tobytes())
                voxels = {n[len(_MAP) :]: archive[n] for n in archive.files if n.startswith(_MAP)}
            state = cls(
                plain["settings"],
                [_step(entry) for entry in plain["steps"]],
                None if plain["unit"] is None else float(plain["unit"]),
                {int(number): float(unit) for number, unit in plain["units"].items()},
                [(int(number), np.array(T)) for number, T in plain["keyframes"]],
                None if plain["previous"] is None else _pair(plain["previous"]),
                None if plain["motion"] is None else _motion(plain["motion"]),
                int(plain["lost_in_a_row"]),
                VoxelMap.from_state(voxels) if voxels else None,
            )
        except (*_BROKEN, EquivAlignError) as error:
            raise UnreadableFileError(
                "the state of an interrupted run can't be read",
                field="out",
                value=path,
                mend="delete it to start again",
            ) from error
        plain_settings = json.loads(json.dumps(dict(settings)))
        other = [name for name, value in plain_settings.items() if state.settings[name] != value]
        if other:
            raise InvalidOptionError(
                f"an interrupted run of other settings lies there ({', '.join(other)} differ)",
                field="out",
                value=path,
                mend="finish it with its own options, delete it, or give another --out",
            )
        return state

    def restore(self, tracker: Tracker, source: FrameSource) -> None:
        """Bring a new tracker to where the other one was; it reads the keyframes again.

        Raises:
            EquivAlignError: a keyframe's file isn't there any more, or has changed.
        """
        if self.motion is None or self.previous is None:
            return
        known: dict[int, Keyframe] = {}
        for number, T in [*self.keyframes, self.previous]:
            if number not in known:
                tracker.preparer.unit = self.units[number]
                known[number] = Keyframe(read_frame(source, number, tracker)[0], T)
        tracker.preparer.unit = self.unit
        keyframes = [known[number] for number, _ in self.keyframes]
        tracker.resume(keyframes, known[self.previous[0]], self.motion, self.lost_in_a_row)


def _plain_step(step: Step) -> dict[str, Any]:
    plain = {name: getattr(step, name) for name in Step.__dataclass_fields__}
    plain["T_world_camera"] = step.T_world_camera.tolist()
    plain["cycle"] = None if step.cycle is None else asdict(step.cycle)
    return plain


def _step(plain: Mapping[str, Any]) -> Step:
    values = dict(plain)
    values["status"] = Status(values["status"])
    values["T_world_camera"] = np.array(values["T_world_camera"], dtype=np.float64)
    values["cycle"] = None if values["cycle"] is None else Cycle(**values["cycle"])
    return Step(**values)


def _plain_motion(motion: ConstantVelocity) -> dict[str, Any]:
    return {
        "time": motion.time,
        "T_world_camera": motion.T_world_camera.tolist(),
        "motion": None if motion.motion is None else motion.motion.tolist(),
        "duration": motion.duration,
    }


def _motion(plain: Mapping[str, Any]) -> ConstantVelocity:
    motion = plain["motion"]
    return ConstantVelocity(
        float(plain["time"]),
        np.array(plain["T_world_camera"]),
        None if motion is None else np.array(motion),
        float(plain["duration"]),
    )


def _pair(plain: Sequence[Any]) -> tuple[int, FloatArray]:
    return int(plain[0]), np.array(plain[1], dtype=np.float64)
