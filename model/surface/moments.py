"""Sums over near pairs of the surface kernel, from which its steps on SE(3) are built.

The kernel of two points x and y = R z + t with normals n and m = R n_z, d = x − y, is

    k = ⟨l_x, l_z⟩ κ(f · R g) (n·m)² ½ [exp(−½ dᵀΛ(n)d) + exp(−½ dᵀΛ(m)d)],
    Λ(n) = (I − nnᵀ)/ℓ² + nnᵀ/ℓ_n²:

the paper's kernel with a metric that is stiffer across the surface than along it, seen from both
sides, so that swapping the clouds inverts the pose. The normals are steerable vectors like f.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.compiled import compiled
from model.profile import gaussian
from model.surface.arrays import SurfaceArrays
from model.surface.cells import FloatArray
from model.surface.near_pairs import SLACK, NearPairs, longest_run
from model.surface.pair_weight import compare_features, count_pairs, pull_features, turn_features
from model.surface.rigid import moved, turned

# exp(−3²/2) = 0.011 is where the kernel ends.
REACH = 3.0
# Cells of a cloud on which the kernel's sums are taken again and again, in ℓ.
VIEW = SLACK * REACH


class SurfaceMoments(NamedTuple):
    """Of S(T) = Σ_ij k_ij at one pose, in δ = (ρ, φ), T = Exp(δ) T̂.

    Attributes:
        value: S.
        gradient: (6,) exact.
        stiffness: (6, 6) Gauss–Newton: the kernel values held, the residuals linear.
        softening: (6, 6) what the fall of the kernel with the distance takes from it: Σ k p pᵀ over
            the pulls p of the pairs. The Hessian is about softening − stiffness.
    """

    value: float
    gradient: FloatArray
    stiffness: FloatArray
    softening: FloatArray


@compiled
def surface_moments(
    pairs: NearPairs,
    target: SurfaceArrays,
    source: SurfaceArrays,
    T: FloatArray,
    lengthscale: float,
    across: float,
    cut: float,
) -> SurfaceMoments:
    """Sum over the pairs nearer than ``cut``.

    Args:
        pairs: all that are nearer than ``cut``, and maybe others.
        target: N points.
        source: M points.
        T: (4, 4) T_target_source.
        lengthscale: ℓ along the surface.
        across: ℓ_n across it.
        cut: pairs farther apart are left out.
    """
    a_iso = 1.0 / (lengthscale * lengthscale)
    a_normal = 1.0 / (across * across) - a_iso
    cut2 = cut * cut
    width = target.features.shape[1]
    channels = width // 3
    g, pull = np.empty(width, np.float32), np.zeros(width)
    longest = longest_run(pairs)
    counts, slopes = np.empty(longest), np.empty(longest)
    H, G = np.zeros((6, 6)), np.zeros((6, 6))
    value = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    for j in range(len(source.points)):
        first, near = pairs.start[j], pairs.start[j + 1] - pairs.start[j]
        if near == 0:
            continue
        y0, y1, y2 = moved(T, source.points, j)
        m0, m1, m2 = turned(T, source.normals, j)
        count_pairs(pairs, target, source, j, counts)
        if width:
            turn_features(source.features, j, T, g)
            compare_features(pairs, target.features, g, j, counts, slopes)
        # Of one source point: mass, Σ k d, the target's planes, the source's, the turning normals.
        mass = e0 = e1 = e2 = 0.0
        p00 = p01 = p02 = p11 = p12 = p22 = v0 = v1 = v2 = 0.0
        own = u = u0 = u1 = u2 = 0.0
        b0 = b1 = b2 = 0.0
        F00 = F01 = F02 = F11 = F12 = F22 = 0.0
        # Without a branch, a call or a store, so that several pairs are taken at once.
        for a in range(near):
            p = pairs.target[first + a]
            d0 = target.points[p, 0] - y0
            d1 = target.points[p, 1] - y1
            d2 = target.points[p, 2] - y2
            x0, x1, x2 = target.normals[p, 0], target.normals[p, 1], target.normals[p, 2]
            distance2 = d0 * d0 + d1 * d1 + d2 * d2
            dot = x0 * m0 + x1 * m1 + x2 * m2
            r = x0 * d0 + x1 * d1 + x2 * d2
            q = m0 * d0 + m1 * d1 + m2 * d2
            iso = distance2 * a_iso
            both = counts[a] if distance2 <= cut2 else 0.0
            w = both * gaussian(iso + r * r * a_normal)
            o = both * gaussian(iso + q * q * a_normal)
            likeness = dot * dot
            spin = 2.0 * dot * (w + o)
            b0, b1, b2 = b0 + spin * x0, b1 + spin * x1, b2 + spin * x2
            w, o = w * likeness, o * likeness
            k = w + o
            mass += k
            e0, e1, e2 = e0 + k * d0, e1 + k * d1, e2 + k * d2
            w0, w1, w2 = w * x0, w * x1, w * x2
            p00, p01, p02 = p00 + w0 * x0, p01 + w0 * x1, p02 + w0 * x2
            p11, p12, p22 = p11 + w1 * x1, p12 + w1 * x2, p22 + w2 * x2
            v0, v1, v2 = v0 + w0 * r, v1 + w1 * r, v2 + w2 * r
            own += o
            pushed = o * q
            u += pushed
            u0, u1, u2 = u0 + pushed * d0, u1 + pushed * d1, u2 + pushed * d2
            i0, i1, i2, rn, qn = a_iso * d0, a_iso * d1, a_iso * d2, a_normal * r, a_normal * q
            f0, f1, f2 = i0 + rn * x0, i1 + rn * x1, i2 + rn * x2
            h0, h1, h2 = i0 + qn * m0, i1 + qn * m1, i2 + qn * m2
            F00, F11, F22 = (
                F00 + w * f0 * f0 + o * h0 * h0,
                F11 + w * f1 * f1 + o * h1 * h1,
                F22 + w * f2 * f2 + o * h2 * h2,
            )
            F01, F02, F12 = (
                F01 + w * f0 * f1 + o * h0 * h1,
                F02 + w * f0 * f2 + o * h0 * h2,
                F12 + w * f1 * f2 + o * h1 * h2,
            )
        if mass == 0.0:
            continue
        value += mass
        # Forces along the surface and across the target's planes act at y, those across the
        # source's planes at x = y + d.
        t0 = a_iso * e0 + a_normal * v0
        t1 = a_iso * e1 + a_normal * v1
        t2 = a_iso * e2 + a_normal * v2
        o0, o1, o2 = a_normal * u * m0, a_normal * u * m1, a_normal * u * m2
        g0, g1, g2 = g0 + t0 + o0, g1 + t1 + o1, g2 + t2 + o2
        g3 += y1 * (t2 + o2) - y2 * (t1 + o1) + a_normal * (u1 * m2 - u2 * m1)
        g4 += y2 * (t0 + o0) - y0 * (t2 + o2) + a_normal * (u2 * m0 - u0 * m2)
        g5 += y0 * (t1 + o1) - y1 * (t0 + o0) + a_normal * (u0 * m1 - u1 * m0)
        g3 += m1 * b2 - m2 * b1
        g4 += m2 * b0 - m0 * b2
        g5 += m0 * b1 - m1 * b0
        if width:
            metric = (a_iso, a_normal, cut2)
            pull_features(pairs, target, (y0, y1, y2), (m0, m1, m2), j, metric, slopes, pull)
        for c in range(channels):
            h0, h1, h2 = g[c], g[channels + c], g[2 * channels + c]
            f0, f1, f2 = pull[c], pull[channels + c], pull[2 * channels + c]
            g3 += h1 * f2 - h2 * f1
            g4 += h2 * f0 - h0 * f2
            g5 += h0 * f1 - h1 * f0
        A00 = a_iso * mass + a_normal * (p00 + own * m0 * m0)
        A01 = a_normal * (p01 + own * m0 * m1)
        A02 = a_normal * (p02 + own * m0 * m2)
        A11 = a_iso * mass + a_normal * (p11 + own * m1 * m1)
        A12 = a_normal * (p12 + own * m1 * m2)
        A22 = a_iso * mass + a_normal * (p22 + own * m2 * m2)
        _add_lever(H, A00, A01, A02, A11, A12, A22, y0, y1, y2)
        _add_lever(G, F00, F01, F02, F11, F12, F22, y0, y1, y2)
    for a in range(6):
        for b in range(a):
            H[a, b], G[a, b] = H[b, a], G[b, a]
    return SurfaceMoments(value, np.array([g0, g1, g2, g3, g4, g5]), H, G)


@compiled
def _add_lever(
    H: FloatArray,
    A00: float,
    A01: float,
    A02: float,
    A11: float,
    A12: float,
    A22: float,
    y0: float,
    y1: float,
    y2: float,
) -> None:
    """Add JᵀAJ with J = [I, −[y]×] to the upper triangle."""
    # B = −A [y]×, column by column: A (e_k × y) with the sign of φ × y.
    B00, B01, B02 = A02 * y1 - A01 * y2, A00 * y2 - A02 * y0, A01 * y0 - A00 * y1
    B10, B11, B12 = A12 * y1 - A11 * y2, A01 * y2 - A12 * y0, A11 * y0 - A01 * y1
    B20, B21, B22 = A22 * y1 - A12 * y2, A02 * y2 - A22 * y0, A12 * y0 - A02 * y1
    H[0, 0] += A00
    H[0, 1] += A01
    H[0, 2] += A02
    H[1, 1] += A11
    H[1, 2] += A12
    H[2, 2] += A22
    H[0, 3] += B00
    H[0, 4] += B01
    H[0, 5] += B02
    H[1, 3] += B10
    H[1, 4] += B11
    H[1, 5] += B12
    H[2, 3] += B20
    H[2, 4] += B21
    H[2, 5] += B22
    H[3, 3] += y1 * B20 - y2 * B10
    H[3, 4] += y1 * B21 - y2 * B11
    H[3, 5] += y1 * B22 - y2 * B12
    H[4, 4] += y2 * B01 - y0 * B21
    H[4, 5] += y2 * B02 - y0 * B22
    H[5, 5] += y0 * B12 - y1 * B02
