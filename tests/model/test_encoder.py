from __future__ import annotations

import pytest
import torch

from model.encoder import ENCODERS, build_encoder
from model.exceptions import InvalidOptionError


def encoder_in_use(name: str, dtype: torch.dtype) -> torch.nn.Module:
    torch.manual_seed(0)
    return build_encoder(name).to(dtype).eval()


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    return ((a - b).norm() / b.norm()).item()


@pytest.mark.parametrize("name", ENCODERS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-5), (torch.float64, 1e-10)])
def test_features_turn_with_the_cloud_and_ignore_its_place(name, dtype, tolerance, cloud, pose):
    encoder = encoder_in_use(name, dtype)
    for seed, angle in enumerate((15.0, 90.0, 179.0)):
        x = cloud(seed).to(dtype)[None]
        T = pose(seed, angle, shift=0.5).to(dtype)
        R, t = T[:3, :3], T[:3, 3]
        with torch.no_grad():
            moved, turned = encoder(x @ R.T + t), R @ encoder(x)
        assert relative(moved, turned) < tolerance


@pytest.mark.parametrize("name", ENCODERS)
def test_features_follow_their_points(name, cloud):
    encoder = encoder_in_use(name, torch.float64)
    x = cloud(3).double()[None]
    order = torch.randperm(x.shape[1], generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        assert relative(encoder(x[:, order]), encoder(x)[:, order]) < 1e-10


@pytest.mark.parametrize("name", ENCODERS)
def test_padding_changes_nothing(name, cloud):
    encoder = encoder_in_use(name, torch.float64)
    x = cloud(4, n=200).double()[None]
    padded = torch.cat([x, torch.zeros(1, 56, 3, dtype=torch.float64)], 1)
    mask = torch.cat([torch.ones(1, 200), torch.zeros(1, 56)], 1).double()
    with torch.no_grad():
        assert relative(encoder(padded, mask)[:, :200], encoder(x)) < 1e-10


@pytest.mark.parametrize("name", ENCODERS)
def test_shape_and_gradient(name, cloud):
    encoder = build_encoder(name)
    x = cloud(5, n=64)[None].repeat(2, 1, 1).requires_grad_()
    f = encoder(x)
    assert f.shape == (2, 64, 3, encoder.channels_out)
    f.square().sum().backward()
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in encoder.parameters())


def test_a_mirror_image_has_other_invariants_in_vn_graph(cloud):
    encoder = encoder_in_use("vn_graph", torch.float64)
    x = cloud(6).double()[None]
    mirror = torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)
    with torch.no_grad():
        f, g = encoder(x), encoder(x * mirror)
    gram = [h.transpose(-1, -2) @ h for h in (f, g)]
    assert relative(gram[0], gram[1]) > 0.01


@pytest.mark.parametrize("n", [4, 7])
@pytest.mark.parametrize("name", ENCODERS)
def test_the_smallest_clouds_have_finite_features(name, n):
    x = torch.randn(1, n, 3, generator=torch.Generator().manual_seed(2))
    assert torch.isfinite(encoder_in_use(name, torch.float32)(x)).all()


def test_unknown_names_and_arguments_are_refused():
    with pytest.raises(InvalidOptionError, match=r"encoder\.name.*vn_graph"):
        build_encoder("pointnet")
    with pytest.raises(InvalidOptionError, match="vn_graph can't be built"):
        build_encoder("vn_graph", depth=3)
