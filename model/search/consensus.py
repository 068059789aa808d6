"""Poses that many matches agree on: three matches give a pose, all of them judge it.

The matches only seed the search; the objective stays free of correspondences.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from model.compiled import compiled
from model.search.hypotheses import distinct

FloatArray = npt.NDArray[np.float64]

# Draws for each triplet that is kept: most fail the test of equal edges.
_DRAWS = 20
# Two poses within this angle and distance (in spacings) are one.
_SAME_ANGLE_DEG, _SAME_DISTANCE = 20.0, 1.5


class MatchedPoints(NamedTuple):
    """Pairs of points whose features look alike.

    Attributes:
        x: (P, 3) target points.
        z: (P, 3) source points.
    """

    x: FloatArray
    z: FloatArray

    @classmethod
    def none(cls) -> MatchedPoints:
        """No pairs."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True)
class ConsensusSettings:
    """How triplets are drawn and judged; lengths are in spacings of the clouds.

    Attributes:
        triplets: how many give a pose.
        kept: most poses that are left.
        edge: shortest edge of a triplet, in the normalised frame.
        edge_tolerance: by how much corresponding edges may differ.
        reach: a match farther off than thrice this doesn't speak for a pose.
        tightening: reaches of the least-squares rounds, one after another.
    """

    triplets: int = 500
    kept: int = 12
    edge: float = 0.2
    edge_tolerance: float = 1.2
    reach: float = 1.0
    tightening: tuple[float, ...] = (1.5, 1.0, 1.0, 0.8)


@dataclass(frozen=True, slots=True)
class Consensus:
    """Poses and who speaks for them, best first.

    Attributes:
        T_target_source: (K, 4, 4) float64.
        support: (K,) matches that agree, each by a Gaussian of its distance.
        tried: triplets that were judged.
    """

    T_target_source: FloatArray
    support: FloatArray
    tried: int

    @classmethod
    def empty(cls) -> Consensus:
        """No pose."""
        return cls(np.zeros((0, 4, 4)), np.zeros(0), 0)


def consensus(
    matches: MatchedPoints, spacing: float, settings: ConsensusSettings, seed: int
) -> Consensus:
    """Draw triplets, judge their poses by all matches, and fit the best to those that agree.

    Args:
        matches: in the normalised frame.
        spacing: of the clouds.
        settings: see ConsensusSettings.
        seed: of the draws.
    """
    if len(matches.x) < 3:
        return Consensus.empty()
    T, score = _triplet_poses(
        matches.x,
        matches.z,
        settings.triplets,
        settings.edge,
        settings.edge_tolerance * spacing,
        settings.reach * spacing,
        seed,
    )
    if len(T) == 0:
        return Consensus(T, score, 0)
    best = distinct(
        torch.from_numpy(T).float(),
        torch.from_numpy(score),
        settings.kept,
        _SAME_ANGLE_DEG,
        _SAME_DISTANCE * spacing,
    )
    tighter, support = _fitted(
        T[best.numpy()], matches.x, matches.z, np.array(settings.tightening) * spacing
    )
    order = np.argsort(-support, kind="stable")
    return Consensus(tighter[order], support[order], len(T))


def fitted(
    T: FloatArray, matches: MatchedPoints, spacing: float, settings: ConsensusSettings
) -> FloatArray:
    """Poses (K, 4, 4) moved to where the matches that agree with them want them."""
    if len(T) == 0 or len(matches.x) == 0:
        return T
    return _fitted(T, matches.x, matches.z, np.array(settings.tightening) * spacing)[0]


def support_of(T: FloatArray, matches: MatchedPoints, reach: float) -> FloatArray:
    """How many matches agree with each pose (K, 4, 4), by Gaussians of this reach, (K,)."""
    if len(matches.x) == 0:
        return np.zeros(len(T))
    return _fitted(T, matches.x, matches.z, np.array([reach]), 0)[1]


@compiled
def _triplet_poses(
    x: FloatArray,
    z: FloatArray,
    count: int,
    edge: float,
    tolerance: float,
    reach: float,
    seed: int,
) -> tuple[FloatArray, FloatArray]:
    """Poses (K, 4, 4) of random triplets with equal edges, and their scores (K,)."""
    np.random.seed(seed % 4294967296)  # noqa: NPY002  compiled code has no other generator
    n = len(x)
    T = np.zeros((count, 4, 4))
    score = np.zeros(count)
    limit = 9.0 * reach * reach
    found = 0
    for _ in range(count * _DRAWS):
        if found == count:
            break
        a, b = np.random.randint(n), np.random.randint(n)  # noqa: NPY002
        if not _edges_agree(x, z, a, b, edge, tolerance):
            continue
        c = np.random.randint(n)  # noqa: NPY002
        if not _edges_agree(x, z, a, c, edge, tolerance):
            continue
        if not _edges_agree(x, z, b, c, edge, tolerance):
            continue
        F, area_x = _triangle_frame(x[a], x[b], x[c])
        G, area_z = _triangle_frame(z[a], z[b], z[c])
        if area_x < 0.1 * edge or area_z < 0.1 * edge:
            continue
        R = F @ G.T
        t = (x[a] + x[b] + x[c]) / 3.0 - R @ ((z[a] + z[b] + z[c]) / 3.0)
        total = 0.0
        for k in range(n):
            d0 = R[0, 0] * z[k, 0] + R[0, 1] * z[k, 1] + R[0, 2] * z[k, 2] + t[0] - x[k, 0]
            d1 = R[1, 0] * z[k, 0] + R[1, 1] * z[k, 1] + R[1, 2] * z[k, 2] + t[1] - x[k, 1]
            d2 = R[2, 0] * z[k, 0] + R[2, 1] * z[k, 1] + R[2, 2] * z[k, 2] + t[2] - x[k, 2]
            inside = 1.0 - (d0 * d0 + d1 * d1 + d2 * d2) / limit
            if inside > 0.0:
                total += inside * inside
        T[found, :3, :3] = R
        T[found, :3, 3] = t
        T[found, 3, 3] = 1.0
        score[found] = total
        found += 1
    return T[:found], score[:found]


@compiled
def _edges_agree(
    x: FloatArray, z: FloatArray, a: int, b: int, edge: float, tolerance: float
) -> bool:
    if a == b:
        return False
    in_x = math.sqrt((x[a, 0] - x[b, 0]) ** 2 + (x[a, 1] - x[b, 1]) ** 2 + (x[a, 2] - x[b, 2]) ** 2)
    in_z = math.sqrt((z[a, 0] - z[b, 0]) ** 2 + (z[a, 1] - z[b, 1]) ** 2 + (z[a, 2] - z[b, 2]) ** 2)
    return in_x >= edge and in_z >= edge and abs(in_x - in_z) <= tolerance


@compiled
def _triangle_frame(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[FloatArray, float]:
    """Axes (3, 3) along ab, within the triangle and across it, and twice its area over |ab|."""
    u, v = b - a, c - a
    u = u / math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    n = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    height = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    n = n / (height + 1e-12)
    F = np.empty((3, 3))
    F[:, 0] = u
    F[0, 1] = n[1] * u[2] - n[2] * u[1]
    F[1, 1] = n[2] * u[0] - n[0] * u[2]
    F[2, 1] = n[0] * u[1] - n[1] * u[0]
    F[:, 2] = n
    return F, height


@compiled
def _fitted(
    T: FloatArray, x: FloatArray, z: FloatArray, reaches: FloatArray, rounds: int = -1
) -> tuple[FloatArray, FloatArray]:
    """Weighted Procrustes rounds of each pose (K, 4, 4), and the support at the end (K,)."""
    if rounds < 0:
        rounds = len(reaches)
    out = T.copy()
    support = np.zeros(len(T))
    S = np.empty((3, 3))
    for k in range(len(T)):
        R = out[k, :3, :3].copy()
        t = out[k, :3, 3].copy()
        for step in range(rounds + 1):
            reach = reaches[min(step, len(reaches) - 1)]
            mass, mx, mz = 0.0, np.zeros(3), np.zeros(3)
            S[:] = 0.0
            for p in range(len(x)):
                d0 = R[0, 0] * z[p, 0] + R[0, 1] * z[p, 1] + R[0, 2] * z[p, 2] + t[0] - x[p, 0]
                d1 = R[1, 0] * z[p, 0] + R[1, 1] * z[p, 1] + R[1, 2] * z[p, 2] + t[1] - x[p, 1]
                d2 = R[2, 0] * z[p, 0] + R[2, 1] * z[p, 1] + R[2, 2] * z[p, 2] + t[2] - x[p, 2]
                q = (d0 * d0 + d1 * d1 + d2 * d2) / (2.0 * reach * reach)
                if q > 5.0:
                    continue
                w = math.exp(-q)
                mass += w
                for a in range(3):
                    mx[a] += w * x[p, a]
                    mz[a] += w * z[p, a]
                    for b in range(3):
                        S[a, b] += w * x[p, a] * z[p, b]
            support[k] = mass
            if step == rounds or mass < 1e-9:
                break
            mx, mz = mx / mass, mz / mass
            for a in range(3):
                for b in range(3):
                    # A little of the present rotation keeps few matches from leaving it open.
                    S[a, b] = S[a, b] / mass - mx[a] * mz[b] + 1e-3 * R[a, b]
            U, _, Vh = np.linalg.svd(S)
            if np.linalg.det(U) * np.linalg.det(Vh) < 0.0:
                U[:, 2] = -U[:, 2]
            R = U @ Vh
            t = mx - R @ mz
        out[k, :3, :3] = R
        out[k, :3, 3] = t
    return out, support
