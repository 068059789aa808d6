from __future__ import annotations

import math

import pytest
import torch

from model.cloud_function import CloudFunction
from model.exceptions import InvalidOptionError
from model.kernel import FEATURE_KERNELS, RkhsKernel


def functions(n: int = 9, m: int = 7, channels: int = 4) -> tuple[CloudFunction, CloudFunction]:
    generator = torch.Generator().manual_seed(0)

    def one(k: int) -> CloudFunction:
        points = torch.randn(1, k, 3, generator=generator, dtype=torch.float64)
        features = torch.randn(1, k, 3, channels, generator=generator, dtype=torch.float64)
        return CloudFunction.of(points, 0.4 * features)

    return one(n), one(m)


ELL = torch.tensor([0.7], dtype=torch.float64)


def test_inner_product_is_the_papers_double_sum():
    target, source = functions()
    expected = 0.0
    for x, f in zip(target.points[0], target.features[0], strict=True):
        for z, g in zip(source.points[0], source.features[0], strict=True):
            rbf = math.exp(-float((x - z).square().sum()) / (2 * 0.7**2))
            expected += rbf * math.tanh(1.0 + float((f * g).sum()))
    assert RkhsKernel("tanh").inner_product(target, source, ELL).item() == pytest.approx(expected)


@pytest.mark.parametrize("name", FEATURE_KERNELS)
def test_slope_and_curvature_are_the_derivatives(name):
    s = torch.linspace(-2, 2, 21, dtype=torch.float64)
    step = 1e-6
    up, down = (FEATURE_KERNELS[name].evaluate(s + d) for d in (step, -step))
    _, slope, curvature = FEATURE_KERNELS[name].evaluate(s)
    torch.testing.assert_close(slope, (up[0] - down[0]) / (2 * step), atol=1e-8, rtol=1e-8)
    torch.testing.assert_close(curvature, (up[1] - down[1]) / (2 * step), atol=1e-8, rtol=1e-8)


@pytest.mark.parametrize("name", FEATURE_KERNELS)
def test_distance_and_similarity_of_equal_and_of_moved_functions(name, pose):
    kernel = RkhsKernel(name)
    target, source = functions()
    same = kernel.products(target, target, ELL)
    assert same.distance.item() == pytest.approx(0.0, abs=1e-9)
    assert same.similarity.item() == pytest.approx(1.0)
    T = pose(0, 70.0)[None]
    R, t = T[:, :3, :3], T[:, :3, 3]
    before = kernel.products(target, source, ELL).distance
    after = kernel.products(target.transformed(R, t), source.transformed(R, t), ELL).distance
    torch.testing.assert_close(after, before)
    swapped = kernel.products(source, target, ELL).distance
    torch.testing.assert_close(swapped, before)


def test_the_exponential_kernel_is_positive_definite_and_tanh_is_not():
    generator = torch.Generator().manual_seed(3)
    points = torch.randn(1, 60, 3, generator=generator, dtype=torch.float64)
    features = torch.randn(1, 60, 3, 2, generator=generator, dtype=torch.float64)
    cloud = CloudFunction.of(points, features)
    wide = torch.tensor([50.0], dtype=torch.float64)
    smallest = {
        name: torch.linalg.eigvalsh(RkhsKernel(name).terms(cloud, cloud, wide).value)[0, 0].item()
        for name in ("exponential", "tanh")
    }
    assert smallest["exponential"] > -1e-9
    assert smallest["tanh"] < -0.1


def test_masks_and_labels_weigh_pairs():
    target, source = functions()
    kernel = RkhsKernel("tanh")
    kept = CloudFunction.of(source.points[:, :4], source.features[:, :4])
    mask = torch.tensor([[1.0] * 4 + [0.0] * 3], dtype=torch.float64)
    masked = CloudFunction.of(source.points, source.features, mask)
    torch.testing.assert_close(
        kernel.inner_product(target, masked, ELL), kernel.inner_product(target, kept, ELL)
    )
    red, blue = torch.eye(2, dtype=torch.float64)
    labelled = CloudFunction.of(target.points, target.features, None, red.expand(1, 9, 2))
    same = CloudFunction.of(source.points, source.features, None, red.expand(1, 7, 2))
    other = CloudFunction.of(source.points, source.features, None, blue.expand(1, 7, 2))
    plain = kernel.inner_product(target, source, ELL)
    torch.testing.assert_close(kernel.inner_product(labelled, same, ELL), plain)
    assert kernel.inner_product(labelled, other, ELL).item() == 0.0


def test_features_that_turn_against_each_other_lower_the_product():
    target, _ = functions()
    against = CloudFunction.of(target.points, -target.features)
    kernel = RkhsKernel("tanh")
    assert kernel.inner_product(target, against, ELL) < kernel.inner_product(target, target, ELL)
    geometric = RkhsKernel("none")
    torch.testing.assert_close(
        geometric.inner_product(target, against, ELL),
        geometric.inner_product(target, target, ELL),
    )


def test_unknown_kernel_is_refused():
    with pytest.raises(InvalidOptionError, match="kernel: unknown feature kernel"):
        RkhsKernel("linear")
