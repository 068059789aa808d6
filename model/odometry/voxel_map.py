"""A map fused from many frames: the mean of the points in each voxel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from model.exceptions import InvalidOptionError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Three coordinates of 21 bits, counted from the middle of their range, fit into 63 bits.
_BITS = 21
_MIDDLE = 1 << (_BITS - 1)
_MASK = (1 << _BITS) - 1
# In a map of more frames than this, a voxel that one frame alone saw is noise.
_FEW_FRAMES = 5


class VoxelMap:
    """Grows with the space that was seen, not with the frames; beyond a limit it coarsens.

    Args:
        edge: of a voxel, in the input's unit.
        most: voxels; where there are more, the edge doubles.

    Raises:
        InvalidOptionError: the edge isn't a positive length.
    """

    def __init__(self, edge: float, most: int = 1_000_000) -> None:
        if not np.isfinite(edge) or edge <= 0.0:
            raise InvalidOptionError(
                "not a positive length",
                field="voxel",
                value=edge,
                mend="give the edge of a voxel in the input's unit",
            )
        self.edge = edge
        self.most = most
        self.frames = 0
        self._keys: IntArray = np.empty(0, np.int64)
        # Points, frames that saw it, Σ x, Σ colour, one row a voxel.
        self._sums: FloatArray = np.empty((0, 8))

    def __len__(self) -> int:
        return len(self._keys)

    def add(
        self,
        points: FloatArray,
        T_world_camera: FloatArray,
        colours: npt.NDArray[np.float32] | None = None,
    ) -> None:
        """Fuse one frame's points.

        Args:
            points: (n, 3) in the sensor's frame.
            T_world_camera: (4, 4).
            colours: (n, 3) from 0 to 1, or None.
        """
        moved = points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        cell = np.floor(moved / self.edge).astype(np.int64) + _MIDDLE
        inside = ((cell >= 0) & (cell <= _MASK)).all(axis=1)
        cell, moved = cell[inside], moved[inside]
        key = (cell[:, 0] << (2 * _BITS)) | (cell[:, 1] << _BITS) | cell[:, 2]
        rows = np.zeros((len(key), 8))
        rows[:, 0] = 1.0
        rows[:, 2:5] = moved
        if colours is not None:
            rows[:, 5:] = colours[inside]
        keys, sums = _summed(key, rows)
        sums[:, 1] = 1.0
        self._merge(keys, sums)
        self.frames += 1
        while len(self._keys) > self.most:
            self._coarsen()

    def points(self) -> FloatArray:
        """(V, 3) means of the voxels, but for those that one frame of many saw."""
        seen = self._certain()
        means: FloatArray = seen[:, 2:5] / seen[:, :1]
        return means

    def colours(self) -> FloatArray:
        """(V, 3) from 0 to 1, the mean colours of ``points()``; black where none were given."""
        seen = self._certain()
        means: FloatArray = seen[:, 5:] / seen[:, :1]
        return means

    def state(self) -> dict[str, npt.NDArray[np.generic]]:
        """All that it holds, as arrays."""
        return {
            "keys": self._keys,
            "sums": self._sums,
            "shape": np.array([self.edge, float(self.frames), float(self.most)]),
        }

    @classmethod
    def from_state(cls, state: Mapping[str, npt.NDArray[np.generic]]) -> VoxelMap:
        """The inverse of ``state``."""
        edge, frames, most = (float(value) for value in state["shape"])
        voxels = cls(edge, int(most))
        voxels.frames = int(frames)
        voxels._keys = state["keys"].astype(np.int64)
        voxels._sums = state["sums"].astype(np.float64)
        return voxels

    def _certain(self) -> FloatArray:
        if self.frames <= _FEW_FRAMES:
            return self._sums
        return self._sums[self._sums[:, 1] > 1.0]

    def _merge(self, keys: IntArray, sums: FloatArray) -> None:
        """Add rows whose keys are ascending and differ."""
        at = np.searchsorted(self._keys, keys)
        known = np.zeros(len(keys), np.bool_)
        within = at < len(self._keys)
        known[within] = self._keys[at[within]] == keys[within]
        self._sums[at[known]] += sums[known]
        self._keys = np.insert(self._keys, at[~known], keys[~known])
        self._sums = np.insert(self._sums, at[~known], sums[~known], axis=0)

    def _coarsen(self) -> None:
        """Twice the edge: eight voxels become one. A frame counts once for each of the eight."""
        self.edge *= 2.0
        parts = [(self._keys >> shift) & _MASK for shift in (2 * _BITS, _BITS, 0)]
        x, y, z = (((part - _MIDDLE) >> 1) + _MIDDLE for part in parts)
        self._keys, self._sums = _summed((x << (2 * _BITS)) | (y << _BITS) | z, self._sums)


def _summed(keys: IntArray, rows: FloatArray) -> tuple[IntArray, FloatArray]:
    """Ascending distinct keys, and the sums of their rows."""
    distinct, place = np.unique(keys, return_inverse=True)
    columns = [np.bincount(place, column, len(distinct)) for column in rows.T]
    sums = np.stack(columns, axis=1).astype(np.float64)
    return distinct, sums
