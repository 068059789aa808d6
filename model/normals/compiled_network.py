"""``NormalNetwork`` for inference: the same votes as compiled loops over one cloud."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from torch import Tensor

from model.compiled import compiled
from model.normals.network import FLOOR, PAIR_TRAITS, POINT_TRAITS, WORTH, NormalNetwork
from model.side_by_side import side_by_side
from model.surface.axes import least_axis
from model.surface.cells import Cells, FloatArray, IntArray, runs_around
from model.surface.near_pairs import Rows, with_room

Array32 = npt.NDArray[np.float32]

_FIRST_ROOM = 32


class RoundWeights(NamedTuple):
    """Of one round, with H hidden units and Z numbers of memory; without memory before, Z is 0.

    Attributes:
        pair: (H, PAIR_TRAITS), or a column more for two clouds that meet.
        pair_bias: (H,).
        here: (H, Z) of the point's memory.
        there: (H, Z) of the neighbour's.
        say: (2 + Z, H).
        say_bias: (2 + Z,).
        keep: (Z, Z + POINT_TRAITS) or (Z, 2 Z + POINT_TRAITS).
        keep_bias: (Z,).
    """

    pair: Array32
    pair_bias: Array32
    here: Array32
    there: Array32
    say: Array32
    say_bias: Array32
    keep: Array32
    keep_bias: Array32


class CloudState(NamedTuple):
    """What the points of one cloud know before a round.

    Attributes:
        start: (N + 1,) where each point's neighbours begin.
        near: (E,) their rows.
        points: (N, 3).
        normals: (N, 3).
        layer: (N,) which of two clouds that meet each is of; 0 in a cloud by itself.
        memory: (N, Z); Z is 0 in the first round.
    """

    start: IntArray
    near: Rows
    points: FloatArray
    normals: FloatArray
    layer: IntArray
    memory: Array32


class CompiledNormals:
    """Corrects the normals of one cloud, or of two that meet.

    Args:
        network: whose weights.
    """

    def __init__(self, network: NormalNetwork) -> None:
        weights = network.state_dict()
        rounds, hidden = network.architecture["rounds"], network.architecture["hidden"]
        none = np.zeros((hidden, 0), np.float32)
        self._rounds = [
            RoundWeights(
                _array(weights[f"pair.{r}.weight"]),
                _array(weights[f"pair.{r}.bias"]),
                _array(weights[f"here.{r - 1}.weight"]) if r else none,
                _array(weights[f"there.{r - 1}.weight"]) if r else none,
                _array(weights[f"say.{r}.weight"]),
                _array(weights[f"say.{r}.bias"]),
                _array(weights[f"keep.{r}.weight"]),
                _array(weights[f"keep.{r}.bias"]),
            )
            for r in range(rounds)
        ]
        self._worth: tuple[Array32, Array32] | None = None
        if network.worth is not None:
            self._worth = _array(weights["worth.weight"])[0], _array(weights["worth.bias"])

    def __call__(
        self, cells: Cells, normals: FloatArray, reach: float, spacing: float
    ) -> FloatArray:
        """(N, 3) unit normals.

        Args:
            cells: of the cloud, at least ``reach`` in size.
            normals: (N, 3) fitted, in cell order.
            reach: within which points are neighbours.
            spacing: of the cloud.
        """
        alone = np.zeros(len(normals), np.int64)
        return self._state(cells, normals, reach, spacing, alone).normals

    def of_pair(
        self, cells: Cells, normals: FloatArray, reach: float, spacing: float, layer: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Unit normals (N, 3) and weights (N,); the weights are 1 from a network of one layer.

        Args:
            cells: of both clouds as one, at least ``reach`` in size.
            normals: (N, 3) fitted, in cell order.
            reach: within which points are neighbours.
            spacing: of both clouds as one.
            layer: (N,) which of both each point is of, in cell order.
        """
        state = self._state(cells, normals, reach, spacing, layer)
        if self._worth is None:
            return state.normals, np.ones(len(normals))
        weight, bias = self._worth
        said = (state.memory @ weight + bias).astype(np.float64)
        return state.normals, 1.0 / (1.0 + np.exp(-WORTH * said))

    def _state(
        self, cells: Cells, normals: FloatArray, reach: float, spacing: float, layer: IntArray
    ) -> CloudState:
        """After the last round."""
        start, near = neighbours(cells, reach)
        memory = np.zeros((len(normals), 0), np.float32)
        state = CloudState(start, near, cells.points, normals, layer, memory)
        for weights in self._rounds:
            state = _voted(state, spacing, weights)
        return state


def _voted(state: CloudState, spacing: float, weights: RoundWeights) -> CloudState:
    """The state after a round, half of the points in each of two threads."""
    n = len(state.points)
    normals, memory = np.empty((n, 3)), np.empty((n, len(weights.keep_bias)), np.float32)
    side_by_side(
        lambda rows: vote(state, spacing, weights, *rows, normals, memory),
        ((0, n // 2), (n // 2, n)),
    )
    return state._replace(normals=normals, memory=memory)


@compiled
def neighbours(cells: Cells, reach: float) -> tuple[IntArray, Rows]:
    """Where each point's neighbours within ``reach`` begin, (N + 1,), and their rows, (E,)."""
    x = cells.points
    start = np.zeros(len(x) + 1, np.int64)
    near = np.empty(_FIRST_ROOM * len(x), np.int32)
    runs = np.empty((9, 2), np.int64)
    count, reach2 = 0, reach * reach
    for i in range(len(x)):
        for run in range(runs_around(cells, x[i, 0], x[i, 1], x[i, 2], runs)):
            a, b = runs[run, 0], runs[run, 1]
            near = with_room(near, count, b - a)
            for p in range(a, b):
                d0, d1, d2 = x[p, 0] - x[i, 0], x[p, 1] - x[i, 1], x[p, 2] - x[i, 2]
                near[count] = p
                count += (d0 * d0 + d1 * d1 + d2 * d2 <= reach2) & (p != i)
        start[i + 1] = count
    return start, near[:count].copy()


@compiled
def vote(
    state: CloudState,
    spacing: float,
    weights: RoundWeights,
    first_row: int,
    past_row: int,
    out: FloatArray,
    memory_out: Array32,
) -> None:
    """One round for some of the points; see ``NormalNetwork``.

    Args:
        state: of the cloud.
        spacing: of the cloud.
        weights: of the round.
        first_row: of the points.
        past_row: the row after the last of them.
        out: (N, 3) gets their normals.
        memory_out: (N, Z) gets what they remember.
    """
    start, near, x, normals, layer, memory = state
    layered = weights.pair.shape[1] > PAIR_TRAITS
    n, Z, H = len(x), memory.shape[1], len(weights.pair_bias)
    kept = len(weights.keep_bias)
    there = np.zeros((H, n), np.float32)
    for h in range(H):
        for z in range(Z):
            for i in range(n):
                there[h, i] += weights.there[h, z] * memory[i, z]
    longest = 1
    for i in range(n):
        longest = max(longest, start[i + 1] - start[i])
    e, u = np.empty((3, longest)), np.empty((3, longest))
    traits = np.zeros((7, longest), np.float32)
    hidden = np.empty(longest, np.float32)
    said = np.empty((2, longest), np.float32)
    heard, flatness = np.empty(kept, np.float32), np.empty(3)
    inverse = 1.0 / spacing
    for i in range(first_row, past_row):
        first, count = start[i], start[i + 1] - start[i]
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        for a in range(count):
            p = near[first + a]
            e0 = (x[p, 0] - x[i, 0]) * inverse
            e1 = (x[p, 1] - x[i, 1]) * inverse
            e2 = (x[p, 2] - x[i, 2]) * inverse
            u0, u1, u2 = normals[p, 0], normals[p, 1], normals[p, 2]
            r2 = e0 * e0 + e1 * e1 + e2 * e2
            above, below = e0 * n0 + e1 * n1 + e2 * n2, e0 * u0 + e1 * u1 + e2 * u2
            facing = n0 * u0 + n1 * u1 + n2 * u2
            e[0, a], e[1, a], e[2, a] = e0, e1, e2
            u[0, a], u[1, a], u[2, a] = u0, u1, u2
            traits[0, a] = math.sqrt(r2)
            traits[1, a] = 0.25 * r2
            traits[2, a] = abs(above)
            traits[3, a] = abs(below)
            traits[4, a] = facing * facing
            traits[5, a] = above * below * facing
            traits[6, a] = layer[p] == layer[i]
        for a in range(count):
            said[0, a], said[1, a] = weights.say_bias[0], weights.say_bias[1]
        for z in range(kept):
            heard[z] = weights.say_bias[2 + z] if count else np.float32(0.0)
        for h in range(H):
            own = weights.pair_bias[h]
            for z in range(Z):
                own += weights.here[h, z] * memory[i, z]
            w0, w1, w2 = weights.pair[h, 0], weights.pair[h, 1], weights.pair[h, 2]
            w3, w4, w5 = weights.pair[h, 3], weights.pair[h, 4], weights.pair[h, 5]
            w6 = weights.pair[h, 6] if layered else np.float32(0.0)
            for a in range(count):
                hidden[a] = (
                    own
                    + w0 * traits[0, a]
                    + w1 * traits[1, a]
                    + w2 * traits[2, a]
                    + w3 * traits[3, a]
                    + w4 * traits[4, a]
                    + w5 * traits[5, a]
                    + w6 * traits[6, a]
                )
            if Z:
                for a in range(count):
                    hidden[a] += there[h, near[first + a]]
            s0, s1, total = weights.say[0, h], weights.say[1, h], np.float32(0.0)
            for a in range(count):
                value = hidden[a] / (np.float32(1.0) + abs(hidden[a]))
                said[0, a] += s0 * value
                said[1, a] += s1 * value
                total += value
            for z in range(kept):
                heard[z] += weights.say[2 + z, h] * total / np.float32(max(count, 1))
        axis = _agreed(e, u, said, count, n0, n1, n2, flatness)
        fitted = n0 * n0 + n1 * n1 + n2 * n2 > 0.0
        for c in range(3):
            out[i, c] = axis[c] if fitted else 0.0
        for z in range(kept):
            value = weights.keep_bias[z]
            for c in range(kept):
                value += weights.keep[z, c] * heard[c]
            for c in range(POINT_TRAITS):
                value += weights.keep[z, kept + c] * np.float32(flatness[c])
            for c in range(Z):
                value += weights.keep[z, kept + POINT_TRAITS + c] * memory[i, c]
            memory_out[i, z] = value / (np.float32(1.0) + abs(value))


@compiled
def _agreed(
    e: FloatArray,
    u: FloatArray,
    said: Array32,
    count: int,
    n0: float,
    n1: float,
    n2: float,
    flatness: FloatArray,
) -> tuple[float, float, float]:
    """The axis that the neighbours agree on; ``flatness`` (POINT_TRAITS,) is filled."""
    total = m0 = m1 = m2 = c00 = c01 = c02 = c11 = c12 = c22 = 0.0
    a00, a01, a02, a11, a12, a22 = n0 * n0, n0 * n1, n0 * n2, n1 * n1, n1 * n2, n2 * n2
    for k in range(count):
        x, y = float(said[0, k]), float(said[1, k])
        trust, w = 0.5 * (x + math.sqrt(x * x + 1.0)), 0.5 * (y + math.sqrt(y * y + 1.0))
        u0, u1, u2 = u[0, k], u[1, k], u[2, k]
        a00, a01, a02 = a00 + trust * u0 * u0, a01 + trust * u0 * u1, a02 + trust * u0 * u2
        a11, a12, a22 = a11 + trust * u1 * u1, a12 + trust * u1 * u2, a22 + trust * u2 * u2
        e0, e1, e2 = e[0, k], e[1, k], e[2, k]
        total += w
        m0, m1, m2 = m0 + w * e0, m1 + w * e1, m2 + w * e2
        c00, c01, c02 = c00 + w * e0 * e0, c01 + w * e0 * e1, c02 + w * e0 * e2
        c11, c12, c22 = c11 + w * e1 * e1, c12 + w * e1 * e2, c22 + w * e2 * e2
    # Σ w (e − ē)(e − ē)ᵀ with ē = m / (total + FLOOR).
    whole = total + FLOOR
    share = (2.0 - total / whole) / whole
    c00, c01, c02 = c00 - share * m0 * m0, c01 - share * m0 * m1, c02 - share * m0 * m2
    c11, c12, c22 = c11 - share * m1 * m1, c12 - share * m1 * m2, c22 - share * m2 * m2
    v0, v1, v2 = least_axis(c00 - a00, c01 - a01, c02 - a02, c11 - a11, c12 - a12, c22 - a22)
    height = (
        v0 * (c00 * v0 + c01 * v1 + c02 * v2)
        + v1 * (c01 * v0 + c11 * v1 + c12 * v2)
        + v2 * (c02 * v0 + c12 * v1 + c22 * v2)
    )
    flatness[0] = math.log(max(height, 0.0) + FLOOR) - math.log(c00 + c11 + c22 + FLOOR)
    flatness[1] = math.log(whole)
    flatness[2] = abs(m0 * v0 + m1 * v1 + m2 * v2) / whole
    return v0, v1, v2


def _array(weight: Tensor) -> Array32:
    return np.ascontiguousarray(weight.detach().float().numpy())
