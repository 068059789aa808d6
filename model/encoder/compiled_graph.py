"""``VNGraph`` for inference: the same network as compiled loops, which leave PyTorch's lock alone.

PyTorch takes some 300 small steps a network, most of them shorter than the time to start one, and
two clouds can't be encoded at once while its steps take turns at the interpreter's lock. Averages
are linear, so here the mixing matrices come before them; nothing else differs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from model.compiled import compiled
from model.encoder.compiled_balls import first_look, weigh_ball
from model.encoder.dense import (
    Array32,
    add_product,
    affine,
    layer_norm,
    padded,
    product,
    product_by_rows,
    silu,
)
from model.encoder.vector_neuron import EPSILON
from model.encoder.vn_graph import GraphConvolution, VNGraph
from model.encoder.vn_scales import VNScales

FloatArray = npt.NDArray[np.float64]


class Perceptron(NamedTuple):
    """Two linear layers, each followed by SiLU; weights are (in, out)."""

    first: Array32
    first_bias: Array32
    second: Array32
    second_bias: Array32


class LayerWeights(NamedTuple):
    """Of one graph convolution with C channels, D invariants and R balls.

    Attributes:
        vectors: (C, (1 + R) C) what mixes a point's own vectors, then those of each ball.
        direction: (C, C) of the leaky ReLU.
        slope: of the leaky ReLU.
        invariants: (D, (1 + R) D) what mixes a point's own invariants, then those of each ball.
        products: (2 C, D) what mixes the products of the vectors.
        mix: the rest of that perceptron, whose first bias belongs to the mixing above.
        gate: (D, C).
        gate_bias: (C,).
    """

    vectors: Array32
    direction: Array32
    slope: float
    invariants: Array32
    products: Array32
    mix: Perceptron
    gate: Array32
    gate_bias: Array32

    @classmethod
    def of(cls, layer: GraphConvolution, balls: int) -> LayerWeights:
        """Take a layer's weights; the balls' columns are put side by side."""
        channels = layer.centre.weight.shape[0]
        neighbours = _array(layer.neighbours.weight)
        mixing = _array(layer.mix_invariants[0].weight)
        width = mixing.shape[0]
        blocks = [neighbours[:, r * channels : (r + 1) * channels].T for r in range(balls)]
        own = [mixing[:, r * width : (r + 1) * width].T for r in range(1 + balls)]
        return cls(
            _joined([_array(layer.centre.weight).T, *blocks]),
            _transposed(layer.activation.direction.weight),
            layer.activation.slope,
            _joined(own),
            np.ascontiguousarray(mixing[:, (1 + balls) * width :].T),
            _perceptron(layer.mix_invariants),
            _transposed(layer.gate.weight),
            _array(layer.gate.bias),
        )


class LiftWeights(NamedTuple):
    """Of what comes before the first layer; V first vectors, S first invariants.

    Attributes:
        norm: (S,) of the layer norm.
        norm_bias: (S,).
        norm_epsilon: added to the variance.
        invariants: (S, D) and (D, D).
        vectors: (V, C).
        gate: (D, C).
        gate_bias: (C,).
        point_epsilon: of the vectors' norm.
    """

    norm: Array32
    norm_bias: Array32
    norm_epsilon: float
    invariants: Perceptron
    vectors: Array32
    gate: Array32
    gate_bias: Array32
    point_epsilon: float

    @classmethod
    def of(cls, graph: VNGraph) -> LiftWeights:
        """Take a network's weights."""
        return cls(
            _array(graph.moment_norm.weight),
            _array(graph.moment_norm.bias),
            graph.moment_norm.eps,
            _perceptron(graph.lift_invariants),
            _transposed(graph.lift.weight),
            _transposed(graph.lift_gate.weight),
            _array(graph.lift_gate.bias),
            graph.point_norm.epsilon,
        )


class HeadWeights(NamedTuple):
    """Of the features: (L C, C_out) after L levels, their gate (D, C_out), and √γ."""

    vectors: Array32
    gate: Array32
    gate_bias: Array32
    scale: float

    @classmethod
    def of(cls, graph: VNGraph) -> HeadWeights:
        """Take a network's weights."""
        return cls(
            _transposed(graph.head.weight),
            _transposed(graph.head_gate.weight),
            _array(graph.head_gate.bias),
            math.exp(0.5 * graph.scale.log_gamma.item()),
        )


class CompiledGraph:
    """One ``VNGraph`` with the weights it has now.

    Args:
        graph: see VNGraph.
    """

    def __init__(self, graph: VNGraph) -> None:
        self._radii = graph.radii
        self._compact = graph.profile == "compact"
        self._widths = np.array(graph.widths())
        self._lift = LiftWeights.of(graph)
        self._layers = [
            LayerWeights.of(layer, len(graph.radii))
            for layer in graph.convolutions
            if isinstance(layer, GraphConvolution)
        ]
        self._head = HeadWeights.of(graph)

    def __call__(self, x: FloatArray) -> Array32:
        """(N, 3) points → (N, 3, C) features."""
        n, rows = len(x), np.ascontiguousarray(x.T)
        balls = np.zeros((padded(n), len(self._radii) * n), np.float32)
        moments = [
            weigh_ball(rows, radius, self._compact, balls[:, r * n : (r + 1) * n])
            for r, radius in enumerate(self._radii)
        ]
        means, covariances = (np.stack(moment) for moment in zip(*moments, strict=True))
        vectors, scalars = first_look(means, covariances, self._widths)
        f, h = _lifted(vectors, scalars, self._lift)
        levels = [f]
        for layer in self._layers:
            f, h = _convolved(f, h, balls, layer, self._lift.point_epsilon)
            levels.append(f)
        return _features(np.concatenate(levels, axis=-1), h, self._head)


class CompiledEncoder:
    """The encoders that have a compiled form, called as the modules are, one cloud at a time.

    Args:
        graphs: whose channels follow one another.
    """

    def __init__(self, graphs: list[VNGraph]) -> None:
        self._graphs = [CompiledGraph(graph) for graph in graphs]

    def __call__(self, x: Tensor) -> Tensor:
        """(1, N, 3) points → (1, N, 3, C)."""
        points = x[0].double().numpy()
        return torch.from_numpy(np.concatenate([graph(points) for graph in self._graphs], -1))[None]


def compiled_encoder(encoder: nn.Module) -> CompiledEncoder | None:
    """The compiled form of an encoder, or None where it has none."""
    if isinstance(encoder, VNGraph):
        return CompiledEncoder([encoder])
    if isinstance(encoder, VNScales):
        return CompiledEncoder([scale for scale in encoder.scales if isinstance(scale, VNGraph)])
    return None


def _convolved(
    f: Array32, h: Array32, balls: Array32, weights: LayerWeights, epsilon: float
) -> tuple[Array32, Array32]:
    """One graph convolution of vectors (N, 3, C) and invariants (N, D) over balls (≥ N, R N)."""
    mixed_f = product(f.reshape(-1, f.shape[-1]), weights.vectors)
    mixed_h = product(h, weights.invariants)
    averages = product_by_rows(balls, _turned(mixed_f, mixed_h, balls.shape[1] // len(h)))
    return _updated(f, h, mixed_f, mixed_h, averages, weights, epsilon)


@compiled
def _turned(mixed_f: Array32, mixed_h: Array32, balls: int) -> Array32:
    """(≥ D + 3 C, R N): what each ball averages, invariants before vectors, point after point."""
    n = len(mixed_h)
    D, C = mixed_h.shape[1] // (1 + balls), mixed_f.shape[1] // (1 + balls)
    out = np.empty((-(-(D + 3 * C) // 4) * 4, balls * n), np.float32)
    out[D + 3 * C :] = 0.0
    for r in range(balls):
        for k in range(D):
            for i in range(n):
                out[k, r * n + i] = mixed_h[i, (r + 1) * D + k]
        for a in range(3):
            for c in range(C):
                for i in range(n):
                    out[D + a * C + c, r * n + i] = mixed_f[3 * i + a, (r + 1) * C + c]
    return out


@compiled
def _updated(
    f: Array32,
    h: Array32,
    mixed_f: Array32,
    mixed_h: Array32,
    averages: Array32,
    weights: LayerWeights,
    epsilon: float,
) -> tuple[Array32, Array32]:
    """The layer's vectors and invariants from the averages over its balls."""
    n, C, D = f.shape[0], f.shape[2], h.shape[1]
    both = np.empty((3 * n, C), np.float32)
    products = np.zeros((n, 2 * C), np.float32)
    mixed = np.empty((n, D), np.float32)
    for i in range(n):
        for k in range(D):
            mixed[i, k] = mixed_h[i, k] + averages[i, k] + weights.mix.first_bias[k]
        for a in range(3):
            for c in range(C):
                centre, gathered = mixed_f[3 * i + a, c], averages[i, D + a * C + c]
                for r in range(1, mixed_f.shape[1] // C):
                    gathered -= mixed_f[3 * i + a, r * C + c]
                both[3 * i + a, c] = centre + gathered
                products[i, c] += centre * gathered
                products[i, C + c] += gathered * gathered
    add_product(products, weights.products, mixed)
    silu(mixed)
    mixed = affine(mixed, weights.mix.second, weights.mix.second_bias)
    silu(mixed)
    out_h = h + mixed
    gate = affine(out_h, weights.gate, weights.gate_bias)
    direction = product(both, weights.direction)
    out_f = np.empty_like(f)
    for i in range(n):
        for c in range(C):
            along, length2 = np.float32(0.0), np.float32(EPSILON)
            for a in range(3):
                k = direction[3 * i + a, c]
                along += both[3 * i + a, c] * k
                length2 += k * k
            against = np.float32(1.0 - weights.slope) * min(along, np.float32(0.0)) / length2
            for a in range(3):
                turned = both[3 * i + a, c] - against * direction[3 * i + a, c]
                out_f[i, a, c] = f[i, a, c] + turned * gate[i, c]
    _normalise(out_f, epsilon)
    return out_f, out_h


@compiled
def _lifted(vectors: Array32, scalars: Array32, weights: LiftWeights) -> tuple[Array32, Array32]:
    """First vectors (N, 3, V) and invariants (N, S) → (N, 3, C) and (N, D)."""
    layer_norm(scalars, weights.norm, weights.norm_bias, weights.norm_epsilon)
    h = affine(scalars, weights.invariants.first, weights.invariants.first_bias)
    silu(h)
    h = affine(h, weights.invariants.second, weights.invariants.second_bias)
    silu(h)
    gate = affine(h, weights.gate, weights.gate_bias)
    n, V = vectors.shape[0], vectors.shape[2]
    f = product(vectors.reshape(3 * n, V), weights.vectors).reshape(n, 3, gate.shape[1])
    for i in range(n):
        for a in range(3):
            for c in range(gate.shape[1]):
                f[i, a, c] *= gate[i, c]
    _normalise(f, weights.point_epsilon)
    return f, h


@compiled
def _normalise(f: Array32, epsilon: float) -> None:
    """Give the vectors (N, 3, C) of each point a mean squared length of 1."""
    channels = f.shape[2]
    for i in range(len(f)):
        total = np.float32(0.0)
        for a in range(3):
            for c in range(channels):
                total += f[i, a, c] * f[i, a, c]
        share = np.float32(1.0 / math.sqrt(total / channels + epsilon))
        for a in range(3):
            for c in range(channels):
                f[i, a, c] *= share


@compiled
def _features(levels: Array32, h: Array32, weights: HeadWeights) -> Array32:
    """The vectors of all levels (N, 3, L C) and the last invariants → (N, 3, C_out)."""
    gate = affine(h, weights.gate, weights.gate_bias)
    n, wide, C = levels.shape[0], levels.shape[2], gate.shape[1]
    out = product(levels.reshape(3 * n, wide), weights.vectors).reshape(n, 3, C)
    for i in range(n):
        length2 = np.float32(EPSILON)
        for a in range(3):
            for c in range(C):
                out[i, a, c] *= gate[i, c]
                length2 += out[i, a, c] * out[i, a, c]
        share = np.float32(weights.scale / math.sqrt(length2))
        for a in range(3):
            for c in range(C):
                out[i, a, c] *= share
    return out


def _array(weight: object) -> Array32:
    assert isinstance(weight, Tensor)
    return np.ascontiguousarray(weight.detach().float().numpy())


def _transposed(weight: object) -> Array32:
    return np.ascontiguousarray(_array(weight).T)


def _joined(blocks: list[Array32]) -> Array32:
    return np.ascontiguousarray(np.concatenate(blocks, axis=1))


def _perceptron(layers: nn.Module) -> Perceptron:
    assert isinstance(layers, nn.Sequential)
    first, second = layers[0], layers[2]
    return Perceptron(
        _transposed(first.weight),
        _array(first.bias),
        _transposed(second.weight),
        _array(second.bias),
    )
