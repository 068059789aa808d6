"""The demo's own parts; ``.ci/run`` runs it whole."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent.parent


@pytest.fixture(scope="module")
def demo() -> Iterator[ModuleType]:
    """``examples/`` isn't a package: the module is loaded from its file."""
    spec = importlib.util.spec_from_file_location("demo", ROOT / "examples" / "demo.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["demo"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["demo"]


def answer(T: np.ndarray) -> dict[str, Any]:
    return {
        "T_target_source": T.tolist(),
        "diagnostics": {
            "similarity": 0.5,
            "rkhs_distance": 1.0,
            "overlap_source": 1.0,
            "overlap_target": 1.0,
            "converged": True,
            "seconds": {"total": 1.0},
            "warnings": ["[low] overlap"],
        },
    }


def test_the_pair_is_always_the_same_and_was_never_trained_on(demo: ModuleType) -> None:
    pair, again = demo.unseen_pair(), demo.unseen_pair()
    np.testing.assert_array_equal(pair.source, again.source)
    assert len(pair.target) != len(pair.source)
    assert yaml.safe_load(demo.CONFIG.read_text())["seed_everything"] != demo.UNSEEN_SEED


def test_the_true_error_is_shown(demo: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    pair = demo.unseen_pair()
    T = pair.T_target_source.double().numpy()
    assert demo.show(answer(T), pair) < 0.1
    turned = T.copy()
    turned[:3, :2] *= -1.0
    assert demo.show(answer(turned), pair) == pytest.approx(180.0, abs=0.1)
    said = capsys.readouterr().out
    assert "true rotation error" in said
    assert "[low] overlap" in said
