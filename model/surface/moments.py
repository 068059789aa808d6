"""Sums over near pairs of the surface kernel, from which its steps on SE(3) are built.

The kernel of two points x and y = R z + t with normals n and m = R n_z, d = x − y, is

    k = ⟨l_x, l_z⟩ κ(f · R g) (n·m)² ½ [exp(−½ dᵀΛ(n)d) + exp(−½ dᵀΛ(m)d)],
    Λ(n) = (I − nnᵀ)/ℓ² + nnᵀ/ℓ_n²:

the paper's kernel with a metric that is stiffer across the surface than along it, seen from both
sides, so that swapping the clouds inverts the pose. The normals are steerable vectors like f.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from model.compiled import compiled
from model.surface.cells import FloatArray
from model.surface.near_pairs import SLACK, NearPairs

# exp(−3²/2) = 0.011 is where the kernel ends.
REACH = 3.0
# Cells of a cloud on which the kernel's sums are taken again and again, in ℓ.
VIEW = SLACK * REACH
# exp(−40/2) = 2·10⁻⁹: pairs that stand so far above each other's planes add nothing.
_NEGLIGIBLE = 40.0


class SurfaceArrays(NamedTuple):
    """A cloud as the compiled sums take it.

    Attributes:
        points: (N, 3).
        normals: (N, 3).
        features: (N, 3C) float32, the three coordinates of all channels; C may be 0.
        labels: (N, L) pose-invariant labels l(x_i); L = 0 stands for l = 1.
        weights: (N,) what each point counts.
    """

    points: FloatArray
    normals: FloatArray
    features: npt.NDArray[np.float32]
    labels: FloatArray
    weights: FloatArray


class SurfaceMoments(NamedTuple):
    """Of S(T) = Σ_ij k_ij at one pose, in δ = (ρ, φ), T = Exp(δ) T̂.

    Attributes:
        value: S.
        gradient: (6,) exact.
        stiffness: (6, 6) Gauss–Newton: the kernel values held, the residuals linear.
    """

    value: float
    gradient: FloatArray
    stiffness: FloatArray


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
    width = target.features.shape[1]
    channels = width // 3
    traits = target.labels.shape[1]
    turned = np.empty(width, np.float32)
    pull = np.zeros(width)
    H = np.zeros((6, 6))
    value = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    for j in range(len(source.points)):
        if pairs.start[j] == pairs.start[j + 1]:
            continue
        z0, z1, z2 = source.points[j, 0], source.points[j, 1], source.points[j, 2]
        y0 = T[0, 0] * z0 + T[0, 1] * z1 + T[0, 2] * z2 + T[0, 3]
        y1 = T[1, 0] * z0 + T[1, 1] * z1 + T[1, 2] * z2 + T[1, 3]
        y2 = T[2, 0] * z0 + T[2, 1] * z1 + T[2, 2] * z2 + T[2, 3]
        n0, n1, n2 = source.normals[j, 0], source.normals[j, 1], source.normals[j, 2]
        m0 = T[0, 0] * n0 + T[0, 1] * n1 + T[0, 2] * n2
        m1 = T[1, 0] * n0 + T[1, 1] * n1 + T[1, 2] * n2
        m2 = T[2, 0] * n0 + T[2, 1] * n1 + T[2, 2] * n2
        for c in range(channels):
            f0 = source.features[j, c]
            f1 = source.features[j, channels + c]
            f2 = source.features[j, 2 * channels + c]
            turned[c] = T[0, 0] * f0 + T[0, 1] * f1 + T[0, 2] * f2
            turned[channels + c] = T[1, 0] * f0 + T[1, 1] * f1 + T[1, 2] * f2
            turned[2 * channels + c] = T[2, 0] * f0 + T[2, 1] * f1 + T[2, 2] * f2
            pull[c] = pull[channels + c] = pull[2 * channels + c] = 0.0
        weight = source.weights[j]
        # Of one source point: mass, Σ k d, the target's planes, the source's, the turning normals.
        mass = e0 = e1 = e2 = 0.0
        p00 = p01 = p02 = p11 = p12 = p22 = v0 = v1 = v2 = 0.0
        own = u = u0 = u1 = u2 = 0.0
        b0 = b1 = b2 = 0.0
        for at in range(pairs.start[j], pairs.start[j + 1]):
            p = pairs.target[at]
            d0 = target.points[p, 0] - y0
            d1 = target.points[p, 1] - y1
            d2 = target.points[p, 2] - y2
            distance2 = d0 * d0 + d1 * d1 + d2 * d2
            if distance2 > cut * cut:
                continue
            x0, x1, x2 = target.normals[p, 0], target.normals[p, 1], target.normals[p, 2]
            dot = x0 * m0 + x1 * m1 + x2 * m2
            likeness = dot * dot
            if likeness < 1e-4:
                continue
            r = x0 * d0 + x1 * d1 + x2 * d2
            q = m0 * d0 + m1 * d1 + m2 * d2
            iso = distance2 * a_iso
            from_target, from_source = iso + r * r * a_normal, iso + q * q * a_normal
            if min(from_target, from_source) > _NEGLIGIBLE:
                continue
            both = 0.5 * weight * target.weights[p]
            if traits:
                c_xz = 0.0
                for c in range(traits):
                    c_xz += target.labels[p, c] * source.labels[j, c]
                both *= c_xz
            w = both * math.exp(-0.5 * from_target)
            o = both * math.exp(-0.5 * from_source)
            if width:
                s = np.float32(0.0)
                for c in range(width):
                    s += target.features[p, c] * turned[c]
                kappa = math.tanh(1.0 + s)
                bend = (1.0 - kappa * kappa) * likeness * (w + o)
                for c in range(width):
                    pull[c] += bend * target.features[p, c]
                w, o = w * kappa, o * kappa
            spin = 2.0 * dot * (w + o)
            b0, b1, b2 = b0 + spin * x0, b1 + spin * x1, b2 + spin * x2
            w, o = w * likeness, o * likeness
            k = w + o
            mass += k
            e0, e1, e2 = e0 + k * d0, e1 + k * d1, e2 + k * d2
            p00, p01, p02 = p00 + w * x0 * x0, p01 + w * x0 * x1, p02 + w * x0 * x2
            p11, p12, p22 = p11 + w * x1 * x1, p12 + w * x1 * x2, p22 + w * x2 * x2
            v0, v1, v2 = v0 + w * r * x0, v1 + w * r * x1, v2 + w * r * x2
            own += o
            u += o * q
            u0, u1, u2 = u0 + o * q * d0, u1 + o * q * d1, u2 + o * q * d2
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
        for c in range(channels):
            h0, h1, h2 = turned[c], turned[channels + c], turned[2 * channels + c]
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
        _add_stiffness(H, A00, A01, A02, A11, A12, A22, y0, y1, y2)
    for a in range(6):
        for b in range(a):
            H[a, b] = H[b, a]
    return SurfaceMoments(value, np.array([g0, g1, g2, g3, g4, g5]), H)


@compiled
def _add_stiffness(
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
