"""What a near pair counts before its distance is looked at: weights, labels, features."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.profile import gaussian
from model.surface.arrays import SurfaceArrays
from model.surface.cells import FloatArray
from model.surface.near_pairs import NearPairs

Features = npt.NDArray[np.float32]
Vector = tuple[float, float, float]


@compiled
def count_pairs(
    pairs: NearPairs, target: SurfaceArrays, source: SurfaceArrays, j: int, counts: FloatArray
) -> None:
    """Half the product of the weights, times ⟨l_x, l_z⟩, of source point ``j``'s pairs.

    Args:
        pairs: as they are listed.
        target: N points.
        source: M points.
        j: row of the source.
        counts: is filled, pair by pair; at least as long as the longest run.
    """
    first = pairs.start[j]
    half = 0.5 * source.weights[j]
    traits = target.labels.shape[1]
    for a in range(pairs.start[j + 1] - first):
        counts[a] = half * target.weights[pairs.target[first + a]]
        if traits:
            alike = 0.0
            for c in range(traits):
                alike += target.labels[pairs.target[first + a], c] * source.labels[j, c]
            counts[a] *= alike


@compiled
def turn_features(features: Features, j: int, T: FloatArray, turned: Features) -> None:
    """Fill ``turned`` (3C,) with R g_j of features (M, 3C)."""
    channels = features.shape[1] // 3
    for c in range(channels):
        f0, f1, f2 = features[j, c], features[j, channels + c], features[j, 2 * channels + c]
        turned[c] = T[0, 0] * f0 + T[0, 1] * f1 + T[0, 2] * f2
        turned[channels + c] = T[1, 0] * f0 + T[1, 1] * f1 + T[1, 2] * f2
        turned[2 * channels + c] = T[2, 0] * f0 + T[2, 1] * f1 + T[2, 2] * f2


@compiled
def compare_features(
    pairs: NearPairs,
    features: Features,
    turned: Features,
    j: int,
    counts: FloatArray,
    slopes: FloatArray,
) -> None:
    """Multiply ``counts`` by κ = tanh(1 + f·R g_j) (paper, section 4.2) and ``slopes`` by κ′."""
    first = pairs.start[j]
    for a in range(pairs.start[j + 1] - first):
        p = pairs.target[first + a]
        s = np.float32(0.0)
        for c in range(len(turned)):
            s += features[p, c] * turned[c]
        kappa = math.tanh(1.0 + s)
        slopes[a] = counts[a] * (1.0 - kappa * kappa)
        counts[a] *= kappa


@compiled
def pull_features(
    pairs: NearPairs,
    target: SurfaceArrays,
    y: Vector,
    m: Vector,
    j: int,
    metric: Vector,
    slopes: FloatArray,
    pull: FloatArray,
) -> None:
    """Fill ``pull`` (3C,) with Σ k κ′/κ f over the source point's pairs: what turns R g_j.

    Args:
        pairs: as they are listed.
        target: N points.
        y: the source point at the pose.
        m: its normal at the pose.
        j: its row.
        metric: 1/ℓ², 1/ℓ_n² − 1/ℓ² and the square of the distance at which the kernel ends.
        slopes: see ``compare_features``.
        pull: is filled.
    """
    a_iso, a_normal, cut2 = metric
    first = pairs.start[j]
    pull[:] = 0.0
    for a in range(pairs.start[j + 1] - first):
        p = pairs.target[first + a]
        x0, x1, x2 = target.normals[p, 0], target.normals[p, 1], target.normals[p, 2]
        d0 = target.points[p, 0] - y[0]
        d1 = target.points[p, 1] - y[1]
        d2 = target.points[p, 2] - y[2]
        distance2 = d0 * d0 + d1 * d1 + d2 * d2
        if distance2 > cut2:
            continue
        dot = x0 * m[0] + x1 * m[1] + x2 * m[2]
        r, q = x0 * d0 + x1 * d1 + x2 * d2, m[0] * d0 + m[1] * d1 + m[2] * d2
        iso = distance2 * a_iso
        seen = gaussian(iso + r * r * a_normal) + gaussian(iso + q * q * a_normal)
        bend = slopes[a] * dot * dot * seen
        for c in range(len(pull)):
            pull[c] += bend * target.features[p, c]


@compiled
def bend_features(
    pairs: NearPairs,
    target: SurfaceArrays,
    y: FloatArray,
    m: FloatArray,
    j: int,
    metric: Vector,
    slopes: FloatArray,
    turned: Features,
    W: FloatArray,
    Q: FloatArray,
) -> Vector:
    """What the turning of R g_j adds to the second derivatives; see ``surface_curvature``.

    With s = Σ_c f_c · R g_c, s′ = φ·τ for τ = Σ_c R g_c × f_c, and
    (κ F)″ = κ F″ + 2 κ′ s′ F′ + (κ″ s′² + κ′ s″) F, of which the first is left to the caller.

    Args:
        pairs: as they are listed.
        target: N points.
        y: (3,) the source point at the pose.
        m: (3,) its normal at the pose.
        j: its row.
        metric: see ``pull_features``.
        slopes: see ``compare_features``.
        turned: (3C,) R g_j.
        W: (3, 3) of ν and φ, is added to.
        Q: (3, 3) of φ alone, is added to.

    Returns:
        Σ κ′ F τ, the gradient's share.
    """
    a_iso, a_normal, cut2 = metric
    channels = len(turned) // 3
    first = pairs.start[j]
    G, v, spin, tau, total = (
        np.empty((3, 3)),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.zeros(3),
    )
    for at in range(pairs.start[j + 1] - first):
        p = pairs.target[first + at]
        n, d = target.normals[p], target.points[p] - y
        distance2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
        if distance2 > cut2:
            continue
        dot = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
        r, q = n[0] * d[0] + n[1] * d[1] + n[2] * d[2], m[0] * d[0] + m[1] * d[1] + m[2] * d[2]
        half_w = slopes[at] * dot * gaussian(distance2 * a_iso + r * r * a_normal)
        half_o = slopes[at] * dot * gaussian(distance2 * a_iso + q * q * a_normal)
        w, o = half_w * dot, half_o * dot
        G[:] = 0.0
        for k in range(channels):
            for a in range(3):
                for b in range(3):
                    f = target.features[p, b * channels + k]
                    G[a, b] += turned[a * channels + k] * f
        s = G[0, 0] + G[1, 1] + G[2, 2]
        bent = -2.0 * math.tanh(1.0 + s) * (w + o)
        for a in range(3):
            b, e = (a + 1) % 3, (a + 2) % 3
            tau[a] = G[b, e] - G[e, b]
            v[a] = a_iso * (w + o) * d[a] + a_normal * (w * r * n[a] + o * q * m[a])
            across = 2.0 * (half_w + half_o) * (m[b] * n[e] - m[e] * n[b])
            spin[a] = across - a_normal * o * q * (m[b] * d[e] - m[e] * d[b])
        for a in range(3):
            total[a] += (w + o) * tau[a]
            Q[a, a] -= (w + o) * s
            for b in range(3):
                W[a, b] += v[a] * tau[b]
                Q[a, b] += spin[a] * tau[b] + tau[a] * spin[b] + bent * tau[a] * tau[b]
                Q[a, b] += 0.5 * (w + o) * (G[a, b] + G[b, a])
    return total[0], total[1], total[2]
