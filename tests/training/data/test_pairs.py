from __future__ import annotations

import pytest
import torch

from model.exceptions import InvalidOptionError
from training.data.motion import Motion
from training.data.pairs import PairKey, RegistrationPair, ShapePairs, collate, pair_of_shape
from training.data.perturbation import Perturbation
from training.data.seeding import Stream, torch_generator
from training.data.shape import Shape, unit_sphere

POINTS = 300


class Clouds:
    """Three random shapes whose normals are their points."""

    points_per_shape = POINTS

    def __len__(self) -> int:
        return 3

    def __getitem__(self, number: int) -> Shape:
        points = unit_sphere(torch.randn(POINTS, 3, generator=torch_generator(9, number)))
        return Shape(points, torch.nn.functional.normalize(points, dim=1), f"cloud-{number}")


def moved_pair(resample_probability: float, n: int = 100, m: int = 80) -> RegistrationPair:
    law = Perturbation(
        target_points=(n, n), source_points=(m, m), resample_probability=resample_probability
    )
    pair = pair_of_shape(Clouds()[0], law, torch_generator(1))
    return pair.moved(Motion("haar", max_translation=0.5).draw(torch_generator(2)))


def nearest(pair: RegistrationPair) -> torch.Tensor:
    """Distance from every source point, at the true pose, to the nearest target point."""
    T = pair.T_target_source.double()
    source = pair.source.double() @ T[:3, :3].T + T[:3, 3]
    return torch.cdist(source, pair.target.double()).amin(1)


def test_the_pose_maps_the_source_onto_the_target() -> None:
    pair = moved_pair(resample_probability=0.0)
    assert pair.target.shape == (100, 3)
    assert pair.source.shape == (80, 3)
    assert float(nearest(pair).max()) < 1e-6
    assert pair.target_normals is not None
    assert pair.source_normals is not None
    R = pair.T_target_source[:3, :3]
    same = torch.cdist(pair.source @ R.T + pair.T_target_source[:3, 3], pair.target).argmin(1)
    assert torch.allclose(pair.source_normals @ R.T, pair.target_normals[same], atol=1e-5)


def test_resampled_clouds_have_no_point_in_common() -> None:
    assert float(nearest(moved_pair(resample_probability=1.0)).min()) > 1e-4


def test_half_of_the_pairs_are_resampled_at_half_a_chance() -> None:
    shared = sum(
        float(
            nearest(
                pair_of_shape(
                    Clouds()[0],
                    Perturbation(
                        target_points=(50, 50), source_points=(50, 50), resample_probability=0.5
                    ),
                    torch_generator(i),
                )
            ).max()
        )
        < 1e-6
        for i in range(200)
    )
    assert 75 <= shared <= 125


def test_sizes_differ_within_their_ranges() -> None:
    law = Perturbation(target_points=(60, 140), source_points=(20, 50))
    pairs = [pair_of_shape(Clouds()[1], law, torch_generator(i)) for i in range(100)]
    targets = [len(pair.target) for pair in pairs]
    sources = [len(pair.source) for pair in pairs]
    assert 60 <= min(targets) < 70 < 130 < max(targets) <= 140
    assert 20 <= min(sources) < 25 < 45 < max(sources) <= 50


def test_a_batch_is_padded_with_zeros_that_stay_zero() -> None:
    law = Perturbation(target_points=(60, 140), source_points=(20, 50))
    pairs = [pair_of_shape(Clouds()[1], law, torch_generator(i), i) for i in range(5)]
    T = torch.stack(
        [Motion("haar", max_translation=0.5).draw(torch_generator(i)) for i in range(5)]
    )
    batch = collate(pairs).moved(T)
    assert batch.target_mask.sum(1).tolist() == [len(pair.target) for pair in pairs]
    assert batch.source_mask.sum(1).tolist() == [len(pair.source) for pair in pairs]
    assert batch.target.shape[:2] == batch.target_mask.shape
    assert not batch.source[batch.source_mask == 0].any()
    assert not batch.target[batch.target_mask == 0].any()
    assert batch.number.tolist() == [0, 1, 2, 3, 4]
    assert batch.is_synthetic.all()
    assert batch.names == ["cloud-1"] * 5
    for i, pair in enumerate(pairs):
        alone = pair.moved(T[i])
        assert torch.allclose(batch.source[i, : len(pair.source)], alone.source, atol=1e-6)
        assert torch.allclose(batch.T_target_source[i], alone.T_target_source)


def test_swapping_inverts_the_pose() -> None:
    batch = collate([moved_pair(resample_probability=0.0, n=80, m=80)]).swapped()
    T = batch.T_target_source[0]
    back = batch.source[0] @ T[:3, :3].T + T[:3, 3]
    assert float(torch.cdist(back, batch.target[0]).amin(1).max()) < 2e-3
    assert torch.allclose(batch.swapped().T_target_source[0] @ T, torch.eye(4), atol=1e-5)


def test_pairs_depend_on_seed_epoch_and_number_alone() -> None:
    law = Perturbation(sigma=(0.0, 0.02), target_points=(50, 60), source_points=(50, 60))
    first = ShapePairs(Clouds(), law, 10, seed=3, stream=Stream.TRAINING)
    second = ShapePairs(Clouds(), law, 10, seed=3, stream=Stream.TRAINING)
    second[PairKey(5, 1)]
    for key in (PairKey(0, 0), PairKey(2, 7)):
        assert torch.equal(first[key].target, second[key].target)
        assert torch.equal(first[key].source, second[key].source)
    others = [
        first[PairKey(0, 1)],
        first[PairKey(1, 0)],
        ShapePairs(Clouds(), law, 10, seed=4, stream=Stream.TRAINING)[PairKey(0, 0)],
        ShapePairs(Clouds(), law, 10, seed=3, stream=Stream.VALIDATION)[PairKey(0, 0)],
    ]
    for other in others:
        assert not torch.equal(other.target[:50], first[PairKey(0, 0)].target[:50])


def test_every_pass_takes_every_shape_once_and_goes_on_over_epochs() -> None:
    law = Perturbation(target_points=(10, 10), source_points=(10, 10))
    pairs = ShapePairs(Clouds(), law, 4, seed=0, stream=Stream.TRAINING)
    names = [pairs[PairKey(count // 4, count % 4)].name for count in range(30)]
    passes = [names[i : i + 3] for i in range(0, 30, 3)]
    assert all(sorted(taken) == ["cloud-0", "cloud-1", "cloud-2"] for taken in passes)
    assert len({tuple(taken) for taken in passes}) > 1


def test_shapes_must_have_points_for_both_clouds() -> None:
    law = Perturbation(target_points=(200, 200), source_points=(200, 200))
    with pytest.raises(InvalidOptionError, match="400 points"):
        ShapePairs(Clouds(), law, 4, seed=0, stream=Stream.TRAINING)
