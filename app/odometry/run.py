"""One run over a sequence: tracks, fuses the map, keeps what it has, goes on where it stopped."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.odometry.evaluation import Evaluation
from app.odometry.map_file import write_map
from app.odometry.report import write_report
from app.odometry.state_file import RunState
from app.odometry.trajectory_file import kitti_text, tum_text, write_trajectory
from model.odometry import Step, Streamed, Tracker, VoxelMap, stream
from model.sequence import FrameSource

# The state is written after so many seconds, and more rarely where writing it takes long.
_SECONDS_BETWEEN_WRITES = 10.0
_LEAST_RATIO = 20.0
# A voxel is this part of the first frame's radius: about 2 cm in a room.
_VOXELS_PER_RADIUS = 150.0


@dataclass(frozen=True, slots=True)
class Outputs:
    """Files to write; None for those that nobody asked for.

    Attributes:
        out: the trajectory as TUM writes it; beside it lies the state of an unfinished run.
        kitti: the trajectory as KITTI writes it.
        map: the fused map.
        report: the HTML page.
    """

    out: Path | None = None
    kitti: Path | None = None
    map: Path | None = None
    report: Path | None = None

    @property
    def state(self) -> Path | None:
        """Of an unfinished run."""
        return None if self.out is None else self.out.with_name(f"{self.out.name}.unfinished.npz")


class Run:
    """Frames of a source, tracked one after the other.

    Args:
        source: of the frames.
        numbers: of those that are tracked, ascending.
        tracker: new.
        outputs: see Outputs.
        voxel: edge of the map's voxels in the input's unit; None for a part of the first frame.
        coloured: whether the frames have colours.
        settings: everything that decides the trajectory, as plain values.
    """

    def __init__(
        self,
        source: FrameSource,
        numbers: Sequence[int],
        tracker: Tracker,
        outputs: Outputs,
        voxel: float | None,
        coloured: bool,
        settings: Mapping[str, Any],
    ) -> None:
        self.source = source
        self.numbers = numbers
        self.tracker = tracker
        self.outputs = outputs
        self.settings = settings
        self.steps: list[Step] = []
        self.seconds = 0.0
        self.tracked_here = 0
        self._voxel = voxel
        self._coloured = coloured
        self._voxels: VoxelMap | None = None
        self._unit: float | None = None
        # A run whose first frame is refused has nothing to keep.
        self._unsaved = False

    def resume(self) -> int:
        """Take up an unfinished run of the same settings; tells how many frames it had done.

        Raises:
            EquivAlignError: the unfinished run had other settings, or its files are gone.
        """
        state = None
        if self.outputs.state is not None:
            state = RunState.read(self.outputs.state, self.settings)
        if state is None:
            return 0
        state.restore(self.tracker, self.source)
        self.steps = list(state.steps)
        self._voxels, self._unit = state.voxels, state.unit
        return len(self.steps)

    def go(self, tell: Callable[[Step], None]) -> Evaluation:
        """Track what is left; whatever happens, the trajectory so far is written.

        Args:
            tell: gets each step.

        Raises:
            InvalidOptionError: the calibration doesn't fit the images.
            CloudFileError: a file can't be written.
        """
        began = written = time.monotonic()
        pause = _SECONDS_BETWEEN_WRITES
        left = self.numbers[len(self.steps) :]
        try:
            for streamed in stream(self.source, left, self.tracker):
                self._take(streamed)
                self.seconds = time.monotonic() - began
                tell(streamed.step)
                if time.monotonic() - written > pause:
                    before = time.monotonic()
                    self.keep()
                    written = time.monotonic()
                    pause = max(_SECONDS_BETWEEN_WRITES, _LEAST_RATIO * (written - before))
        finally:
            self.keep()
        return self._finish()

    def keep(self) -> None:
        """Write the trajectory so far, and what a later run needs to go on."""
        if not self._unsaved:
            return
        state = self.outputs.state
        if state is not None:
            kept = RunState.of(self.settings, self.steps, self._unit, self.tracker, self._voxels)
            kept.write(state)
        self._write_trajectories()
        self._unsaved = False

    def _take(self, streamed: Streamed) -> None:
        step = streamed.step
        self.steps.append(step)
        self.tracked_here += 1
        self._unsaved = True
        if streamed.unit is not None:
            self._unit = streamed.unit
        wanted = self.outputs.map is not None or self.outputs.report is not None
        if not wanted or streamed.seen is None or not step.status.has_pose:
            return
        if self._voxels is None:
            edge = self._voxel or (streamed.unit or 1.0) / _VOXELS_PER_RADIUS
            self._voxels = VoxelMap(edge)
        self._voxels.add(streamed.seen.points, step.T_world_camera, streamed.seen.colours)

    def _finish(self) -> Evaluation:
        truth = [self.source.T_world_camera(step.number) for step in self.steps]
        evaluation = Evaluation.of(self.steps, truth, self.seconds, self.tracked_here)
        self._write_trajectories()
        if self.outputs.map is not None and self._voxels is not None:
            write_map(self.outputs.map, self._voxels, self._coloured)
        if self.outputs.report is not None:
            write_report(
                self.outputs.report,
                self.source,
                self.steps,
                truth,
                evaluation,
                self._voxels,
                self._coloured,
            )
        if self.outputs.state is not None:
            self.outputs.state.unlink(missing_ok=True)
        return evaluation

    def _write_trajectories(self) -> None:
        if self.outputs.out is not None:
            write_trajectory(self.outputs.out, "out", tum_text, self.steps)
        if self.outputs.kitti is not None:
            write_trajectory(self.outputs.kitti, "kitti", kitti_text, self.steps)
