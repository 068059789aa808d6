"""The compiled form of an encoder against the module it was made from."""

from __future__ import annotations

import pytest
import torch

from model.encoder import build_encoder
from model.encoder.compiled_graph import compiled_encoder

ARCHITECTURES = {
    "gaussian": ("vn_graph", {}),
    "compact": ("vn_graph", {"profile": "compact", "radii": (0.2, 0.5)}),
    "one ball": ("vn_graph", {"radii": (0.3,), "layers": 1}),
    "odd widths": (
        "vn_graph",
        {"channels": 5, "channels_out": 3, "invariants": 7, "layers": 3, "slope": 0.0},
    ),
    "two scales": ("vn_scales", {"channels": 12, "invariants": 20}),
}


def both(kind: str) -> tuple[torch.nn.Module, object]:
    torch.manual_seed(0)
    name, architecture = ARCHITECTURES[kind]
    encoder = build_encoder(name, **architecture).eval()
    compiled = compiled_encoder(encoder)
    assert compiled is not None
    return encoder, compiled


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    return ((a - b).norm() / b.norm()).item()


@pytest.mark.parametrize("n", [4, 97, 300])
@pytest.mark.parametrize("kind", ARCHITECTURES)
def test_it_equals_the_module(kind, n, cloud):
    encoder, compiled = both(kind)
    x = cloud(1, n=n)[None]
    with torch.no_grad():
        exact = encoder.double()(x.double())
    found = compiled(x)
    assert found.shape == exact.shape
    assert relative(found.double(), exact) < 1e-5


@pytest.mark.parametrize("kind", ["gaussian", "two scales"])
def test_its_features_turn_with_the_cloud_and_follow_their_points(kind, cloud, pose):
    _, compiled = both(kind)
    x = cloud(2)
    T = pose(2, 170.0, shift=0.5).float()
    order = torch.randperm(len(x), generator=torch.Generator().manual_seed(3))
    moved = compiled((x @ T[:3, :3].T + T[:3, 3])[order][None])
    assert relative(moved, T[:3, :3] @ compiled(x[None])[:, order]) < 1e-5


def test_an_encoder_with_neighbours_in_feature_space_has_none():
    assert compiled_encoder(build_encoder("vn_dgcnn")) is None
