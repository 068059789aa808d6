"""Compiled loops against what they stand for, and from one process to the next."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from model.cloud_function import CloudFunction
from model.search.matching import compiled_invariants, invariants
from model.surface import cells_of, surface_spacing
from model.surface.axes import least_axis

_DESCEND = """
import numpy as np
from model.surface import VIEW, SurfaceCloud, descend
rng = np.random.default_rng(0)
x = rng.normal(size=(300, 3))
x /= np.linalg.norm(x, axis=1, keepdims=True) * [1.0, 1.4, 2.0]
target, source = SurfaceCloud.of(x[:150] + 0.0), SurfaceCloud.of(x[150:] + [0.03, 0.0, 0.02])
view = target.at(VIEW * 0.2)
found = descend(view.cells, view.arrays, source.arrays, np.eye(4), 0.2, 0.1, 5, 1e-6)
print(found.T_target_source.tobytes().hex())
"""


_WHERE = "import numba, model.compiled; print(numba.config.CACHE_DIR)"


def answer_to(program: str, **environment: Path) -> str:
    """What a new process prints, with these variables set beside our own."""
    return subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **{name: str(value) for name, value in environment.items()}},
        check=True,
        capture_output=True,
        text=True,
    ).stdout


def test_the_process_that_compiles_answers_like_those_that_load(tmp_path: Path):
    answers = [answer_to(_DESCEND, NUMBA_CACHE_DIR=tmp_path) for _ in range(2)]
    assert list(tmp_path.rglob("*.nbc"))
    assert answers[0] == answers[1]


def test_least_axis_is_the_eigenvector_of_the_least_eigenvalue():
    rng = np.random.default_rng(0)
    spectra = [*rng.uniform(0.0, 1.0, size=(50, 3)), [0.0, 1.0, 1.0], [0.3, 0.3 + 1e-7, 1.0]]
    for spectrum in spectra:
        Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        C = 1e-4 * (Q * spectrum) @ Q.T
        n = np.array(least_axis(C[0, 0], C[0, 1], C[0, 2], C[1, 1], C[1, 2], C[2, 2]))
        assert np.linalg.norm(n) == pytest.approx(1.0)
        assert n @ C @ n == pytest.approx(np.linalg.eigvalsh(C)[0], abs=1e-14)


@pytest.mark.parametrize("C", [np.zeros((3, 3)), np.eye(3), np.diag([0.0, 0.0, 2.0])])
def test_least_axis_of_a_matrix_without_one_is_still_a_unit_vector(C):
    n = np.array(least_axis(C[0, 0], C[0, 1], C[0, 2], C[1, 1], C[1, 2], C[2, 2]))
    assert np.linalg.norm(n) == pytest.approx(1.0)
    assert n @ C @ n == pytest.approx(0.0 if C[0, 0] == 0.0 else 1.0)


def lattice(n: int) -> np.ndarray:
    side = np.arange(n, dtype=float)
    return np.stack(np.meshgrid(side, side, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize(
    "points",
    [
        np.random.default_rng(0).normal(size=(500, 3)),
        np.random.default_rng(1).normal(size=(300, 3)) * [1.0, 1e-3, 1e-3],
        np.c_[np.linspace(0.0, 1.0, 100), np.zeros((100, 2))],
        lattice(12),
        np.random.default_rng(2).normal(size=(4, 3)),
        np.repeat(np.random.default_rng(3).normal(size=(40, 3)), 3, axis=0),
        np.r_[np.random.default_rng(4).normal(size=(200, 3)), [[500.0, 0.0, 0.0]]],
    ],
    ids=["ball", "needle", "line", "lattice", "four", "triplets", "stray"],
)
def test_spacing_is_that_of_a_tree(points):
    k = min(6, len(points) - 1)
    distance = KDTree(points).query(points, k=[k + 1])[0]
    assert surface_spacing(points) == pytest.approx(np.median(distance) * np.sqrt(np.pi / k))


def test_cells_hold_the_points_in_their_order():
    points = np.random.default_rng(0).normal(size=(300, 3))
    cells = cells_of(points, 0.7)
    np.testing.assert_array_equal(cells.points, points[cells.order])
    at = np.minimum(((points - cells.low) / cells.size).astype(int), cells.shape - 1)
    flat = (at[:, 0] * cells.shape[1] + at[:, 1]) * cells.shape[2] + at[:, 2]
    np.testing.assert_array_equal(cells.order, np.argsort(flat, kind="stable"))
    np.testing.assert_array_equal(
        np.diff(cells.start), np.bincount(flat, minlength=len(cells.start) - 1)
    )


def test_compiled_invariants_equal_the_differentiable_ones():
    features = torch.randn(1, 40, 3, 6, generator=torch.Generator().manual_seed(0))
    expected = invariants(CloudFunction.of(torch.zeros(1, 40, 3), features))[0]
    found = torch.from_numpy(compiled_invariants(features[0].numpy()))
    torch.testing.assert_close(found, expected)


def test_compiled_code_is_kept_apart_by_its_source(tmp_path: Path):
    question = "import numba, model.compiled as c; print(numba.config.CACHE_DIR, c._fingerprint())"
    place, fingerprint = answer_to(question, NUMBA_CACHE_DIR=tmp_path).split()
    assert place == str(tmp_path / f"compiled-{fingerprint}")


def test_a_place_that_cannot_be_written_is_passed_over(tmp_path: Path):
    (tmp_path / "file").write_text("not a folder")
    cache = tmp_path / "cache"
    kept = answer_to(_WHERE, NUMBA_CACHE_DIR=tmp_path / "file", XDG_CACHE_HOME=cache)
    assert kept.startswith(str(cache / "equivalign" / "compiled-"))


def test_where_nothing_else_can_be_written_a_private_temporary_folder_keeps_it(tmp_path: Path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")

    def kept() -> str:
        return answer_to(_WHERE, NUMBA_CACHE_DIR=blocked, XDG_CACHE_HOME=blocked, TMPDIR=tmp_path)

    private = tmp_path / f"equivalign-{os.geteuid()}"
    assert kept().startswith(str(private / "compiled-"))
    assert private.stat().st_mode & 0o777 == 0o700
    private.chmod(0o777)
    assert not kept().startswith(str(private))
