"""Exact first and second derivatives of the surface kernel's sum on SE(3).

With ν = ρ + φ × y, how fast the source point moves, every factor of a pair's kernel is simple along
the path Exp(εδ) T:

    d′ = −ν,  d″ = −φ × ν,  m′ = φ × m,  m″ = φ × (φ × m),

so the second derivative of each pair is a quadratic form in (ν, φ), summed here point by point, and
turned into one in δ = (ρ, φ) by the lever y.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.compiled import compiled
from model.profile import gaussian
from model.surface.arrays import SurfaceArrays
from model.surface.cells import FloatArray
from model.surface.near_pairs import NearPairs, longest_run
from model.surface.pair_weight import bend_features, compare_features, count_pairs, turn_features
from model.surface.rigid import moved, turned


class SurfaceCurvature(NamedTuple):
    """S(Exp(δ) T) to second order in δ = (ρ, φ).

    Attributes:
        value: S.
        gradient: (6,).
        hessian: (6, 6); negative definite at a maximum.
    """

    value: float
    gradient: FloatArray
    hessian: FloatArray


@compiled
def surface_curvature(
    pairs: NearPairs,
    target: SurfaceArrays,
    source: SurfaceArrays,
    T: FloatArray,
    lengthscale: float,
    across: float,
    cut: float,
) -> SurfaceCurvature:
    """Differentiate twice; the arguments are those of ``surface_moments``."""
    a_iso = 1.0 / (lengthscale * lengthscale)
    a_normal = 1.0 / (across * across) - a_iso
    cut2 = cut * cut
    width = target.features.shape[1]
    g = np.empty(width, np.float32)
    longest = longest_run(pairs)
    counts, slopes = np.empty(longest), np.empty(longest)
    value, gradient, H = 0.0, np.zeros(6), np.zeros((6, 6))
    # Of one source point: the blocks of its form in (ν, φ), and what [m]× is applied to.
    V, W, Q = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    N, P, m, y = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3)
    pull, turning, spin, own_spread = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for j in range(len(source.points)):
        first, near = pairs.start[j], pairs.start[j + 1] - pairs.start[j]
        if near == 0:
            continue
        y0, y1, y2 = moved(T, source.points, j)
        m0, m1, m2 = turned(T, source.normals, j)
        y[0], y[1], y[2], m[0], m[1], m[2] = y0, y1, y2, m0, m1, m2
        count_pairs(pairs, target, source, j, counts)
        if width:
            turn_features(source.features, j, T, g)
            compare_features(pairs, target.features, g, j, counts, slopes)
        mass = mass_own = u = 0.0
        e0 = e1 = e2 = o0 = o1 = o2 = u0 = u1 = u2 = b0 = b1 = b2 = r0 = r1 = r2 = 0.0
        V00 = V01 = V02 = V11 = V12 = V22 = 0.0
        N00 = N01 = N02 = N10 = N11 = N12 = N20 = N21 = N22 = 0.0
        P00 = P01 = P02 = P11 = P12 = P22 = 0.0
        # Without a branch, a call or a store, so that several pairs are taken at once.
        for a in range(near):
            p = pairs.target[first + a]
            d0 = target.points[p, 0] - y0
            d1 = target.points[p, 1] - y1
            d2 = target.points[p, 2] - y2
            n0, n1, n2 = target.normals[p, 0], target.normals[p, 1], target.normals[p, 2]
            distance2 = d0 * d0 + d1 * d1 + d2 * d2
            dot = n0 * m0 + n1 * m1 + n2 * m2
            r = n0 * d0 + n1 * d1 + n2 * d2
            q = m0 * d0 + m1 * d1 + m2 * d2
            iso = distance2 * a_iso
            both = counts[a] if distance2 <= cut2 else 0.0
            seen_w = both * gaussian(iso + r * r * a_normal)
            seen_o = both * gaussian(iso + q * q * a_normal)
            half_w, half_o = seen_w * dot, seen_o * dot
            w, o = half_w * dot, half_o * dot
            k = w + o
            mass, mass_own = mass + k, mass_own + o
            rn, qn = a_normal * r, a_normal * q
            i0, i1, i2 = a_iso * d0, a_iso * d1, a_iso * d2
            f0, f1, f2 = i0 + rn * n0, i1 + rn * n1, i2 + rn * n2
            h0, h1, h2 = i0 + qn * m0, i1 + qn * m1, i2 + qn * m2
            e0, e1, e2 = e0 + k * d0, e1 + k * d1, e2 + k * d2
            o0, o1, o2 = o0 + o * d0, o1 + o * d1, o2 + o * d2
            wr = w * r
            r0, r1, r2 = r0 + wr * n0, r1 + wr * n1, r2 + wr * n2
            oq = o * q
            u, u0, u1, u2 = u + oq, u0 + oq * d0, u1 + oq * d1, u2 + oq * d2
            twice = 2.0 * (half_w + half_o)
            b0, b1, b2 = b0 + twice * n0, b1 + twice * n1, b2 + twice * n2
            wn = a_normal * w
            V00 += w * f0 * f0 + o * h0 * h0 - wn * n0 * n0
            V01 += w * f0 * f1 + o * h0 * h1 - wn * n0 * n1
            V02 += w * f0 * f2 + o * h0 * h2 - wn * n0 * n2
            V11 += w * f1 * f1 + o * h1 * h1 - wn * n1 * n1
            V12 += w * f1 * f2 + o * h1 * h2 - wn * n1 * n2
            V22 += w * f2 * f2 + o * h2 * h2 - wn * n2 * n2
            oqn, two_w, two_o = o * qn, 2.0 * half_w, 2.0 * half_o
            t0, t1, t2 = two_w * f0 + two_o * h0, two_w * f1 + two_o * h1, two_w * f2 + two_o * h2
            l0, l1, l2 = oqn * h0, oqn * h1, oqn * h2
            N00, N01, N02 = (
                N00 + t0 * n0 - l0 * d0,
                N01 + t0 * n1 - l0 * d1,
                N02 + t0 * n2 - l0 * d2,
            )
            N10, N11, N12 = (
                N10 + t1 * n0 - l1 * d0,
                N11 + t1 * n1 - l1 * d1,
                N12 + t1 * n2 - l1 * d2,
            )
            N20, N21, N22 = (
                N20 + t2 * n0 - l2 * d0,
                N21 + t2 * n1 - l2 * d1,
                N22 + t2 * n2 - l2 * d2,
            )
            nn, nd, dd = 2.0 * (seen_w + seen_o), two_o * qn, o * (qn * qn - a_normal)
            P00 += nn * n0 * n0 - 2.0 * nd * n0 * d0 + dd * d0 * d0
            P01 += nn * n0 * n1 - nd * (n0 * d1 + n1 * d0) + dd * d0 * d1
            P02 += nn * n0 * n2 - nd * (n0 * d2 + n2 * d0) + dd * d0 * d2
            P11 += nn * n1 * n1 - 2.0 * nd * n1 * d1 + dd * d1 * d1
            P12 += nn * n1 * n2 - nd * (n1 * d2 + n2 * d1) + dd * d1 * d2
            P22 += nn * n2 * n2 - 2.0 * nd * n2 * d2 + dd * d2 * d2
        value += mass
        V[0, 0], V[0, 1], V[0, 2], V[1, 1], V[1, 2], V[2, 2] = V00, V01, V02, V11, V12, V22
        N[0, 0], N[0, 1], N[0, 2] = N00, N01, N02
        N[1, 0], N[1, 1], N[1, 2] = N10, N11, N12
        N[2, 0], N[2, 1], N[2, 2] = N20, N21, N22
        P[0, 0], P[0, 1], P[0, 2], P[1, 1], P[1, 2], P[2, 2] = P00, P01, P02, P11, P12, P22
        V[1, 0], V[2, 0], V[2, 1] = V01, V02, V12
        P[1, 0], P[2, 0], P[2, 1] = P01, P02, P12
        own_spread[0], own_spread[1], own_spread[2] = o0, o1, o2
        turning[0] = a_iso * e0 + a_normal * (r0 - u * m0)
        turning[1] = a_iso * e1 + a_normal * (r1 - u * m1)
        turning[2] = a_iso * e2 + a_normal * (r2 - u * m2)
        spin[0] = b0 - a_normal * u0
        spin[1] = b1 - a_normal * u1
        spin[2] = b2 - a_normal * u2
        for c in range(3):
            pull[c] = turning[c] + 2.0 * a_normal * u * m[c]
            V[c, c] -= a_iso * mass
            for b in range(3):
                V[c, b] -= a_normal * mass_own * m[c] * m[b]
                N[c, b] += a_normal * m[c] * own_spread[b]
        _cross_right(N, m, W)
        _cross_both(P, m, Q)
        along = m[0] * spin[0] + m[1] * spin[1] + m[2] * spin[2]
        for c in range(3):
            W[c, (c + 1) % 3] -= 0.5 * turning[(c + 2) % 3]
            W[c, (c + 2) % 3] += 0.5 * turning[(c + 1) % 3]
            Q[c, c] -= along
            for b in range(3):
                Q[c, b] += 0.5 * (m[c] * spin[b] + spin[c] * m[b])
        if width:
            metric = (a_iso, a_normal, cut2)
            turned_by = bend_features(pairs, target, y, m, j, metric, slopes, g, W, Q)
            for c in range(3):
                gradient[3 + c] += turned_by[c]
        for c in range(3):
            b, e = (c + 1) % 3, (c + 2) % 3
            gradient[c] += pull[c]
            gradient[3 + c] += y[b] * pull[e] - y[e] * pull[b] + m[b] * spin[e] - m[e] * spin[b]
        _add_with_lever(H, V, W, Q, y)
    for a in range(6):
        for b in range(a):
            H[a, b] = H[b, a]
    return SurfaceCurvature(value, gradient, H)


@compiled
def _cross_right(A: FloatArray, m: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` with A [m]×ᵀ: each row a becomes m × a."""
    for c in range(3):
        out[c, 0] = m[1] * A[c, 2] - m[2] * A[c, 1]
        out[c, 1] = m[2] * A[c, 0] - m[0] * A[c, 2]
        out[c, 2] = m[0] * A[c, 1] - m[1] * A[c, 0]


@compiled
def _cross_both(A: FloatArray, m: FloatArray, out: FloatArray) -> None:
    """Fill ``out`` with [m]× A [m]×ᵀ."""
    B = np.empty((3, 3))
    _cross_right(A, m, B)
    for c in range(3):
        out[0, c] = m[1] * B[2, c] - m[2] * B[1, c]
        out[1, c] = m[2] * B[0, c] - m[0] * B[2, c]
        out[2, c] = m[0] * B[1, c] - m[1] * B[0, c]


@compiled
def _add_with_lever(
    H: FloatArray,
    V: FloatArray,
    W: FloatArray,
    Q: FloatArray,
    y: FloatArray,
) -> None:
    """Add the form [V W; Wᵀ Q] in (ν, φ) as one in δ: ν = ρ + φ × y = ρ − [y]× φ."""
    A = np.empty((3, 3))
    _cross_right(V, y, A)
    for c in range(3):
        for b in range(3):
            A[c, b] += W[c, b]
            H[c, b] += V[c, b]
            H[c, 3 + b] += A[c, b]
    # [y]× (W − V [y]×) − Wᵀ [y]× + Q
    for c in range(3):
        d, e = (c + 1) % 3, (c + 2) % 3
        for b in range(3):
            H[3 + c, 3 + b] += y[d] * A[e, b] - y[e] * A[d, b] + Q[c, b]
            H[3 + b, 3 + c] += y[d] * W[e, b] - y[e] * W[d, b]
