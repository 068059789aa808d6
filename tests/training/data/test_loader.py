from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint

from model.exceptions import InvalidOptionError
from model.se3 import rotation_angle
from training.data.loader import PairLoader, PairSampler
from training.data.motion import Motion
from training.data.pairs import PairBatch, ShapePairs
from training.data.perturbation import Perturbation
from training.data.seeding import Stream, torch_generator
from training.data.shape import Shape, unit_sphere


class Clouds:
    points_per_shape = 64

    def __len__(self) -> int:
        return 50

    def __getitem__(self, number: int) -> Shape:
        points = unit_sphere(torch.randn(64, 3, generator=torch_generator(9, number)))
        return Shape(points, None, f"cloud-{number}")


def loader(
    workers: int = 0,
    batch_size: int = 4,
    fixed: bool = False,
    pairs: int = 20,
    rank: int = 0,
    world_size: int = 1,
    drop_last: bool = True,
) -> PairLoader:
    law = Perturbation(sigma=(0.0, 0.02), target_points=(20, 32), source_points=(20, 32))
    source = ShapePairs(Clouds(), law, pairs, seed=1, stream=Stream.TRAINING)
    return PairLoader(
        source, Motion("uniform_angle", 90.0, 0.3), batch_size, 1, Stream.TRAINING, workers,
        rank, world_size, drop_last, fixed,
    )  # fmt: skip


def assert_same(left: Iterable[PairBatch], right: Iterable[PairBatch]) -> None:
    for a, b in zip(left, right, strict=True):
        assert a.names == b.names
        for one, other in zip(a, b, strict=True):
            same = torch.equal(one, other) if isinstance(one, torch.Tensor) else one == other
            assert same


def test_workers_dont_change_the_pairs_in_any_epoch() -> None:
    alone, helped = loader(0), loader(2)
    for epoch in (0, 1):
        alone.set_epoch(epoch)
        helped.set_epoch(epoch)
        assert_same(list(alone), list(helped))


def test_epochs_differ_and_come_again_by_number() -> None:
    one = loader()
    first = list(one)
    one.set_epoch(1)
    second = list(one)
    one.set_epoch(0)
    assert_same(first, list(one))
    assert first[0].names != second[0].names
    assert len(first) == len(one) == 5


def test_a_fixed_loader_repeats_its_only_epoch() -> None:
    one = loader(fixed=True)
    first = list(one)
    one.set_epoch(3)
    assert_same(first, list(one))


@pytest.mark.parametrize("workers", [0, 2])
def test_a_new_angle_holds_from_the_next_batch(workers: int) -> None:
    one = loader(workers)
    batches = iter(one)
    next(batches)
    one.motion = Motion("exact_angle", 5.0)
    R = next(batches).T_target_source[:, :3, :3]
    angle = torch.rad2deg(rotation_angle(R, torch.eye(3)))
    assert torch.allclose(angle, torch.tensor(5.0), atol=1e-2)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_restored_loader_goes_on_with_the_next_batch(workers: int) -> None:
    whole = loader()
    whole.set_epoch(2)
    expected = list(whole)

    interrupted = loader(workers)
    interrupted.set_epoch(2)
    assert_same(list(islice(interrupted, 2)), expected[:2])
    state = interrupted.state_dict()

    restored = loader(workers)
    restored.load_state_dict(state)
    restored.set_epoch(2)
    assert_same(list(restored), expected[2:])
    assert len(restored) == 5
    assert_same(list(restored), expected)


def test_a_state_from_the_end_of_an_epoch_leads_to_the_next() -> None:
    done = loader()
    list(done)
    restored = loader()
    restored.load_state_dict(done.state_dict())
    assert restored.epoch == 1
    assert len(list(restored)) == 5


def test_an_abandoned_epoch_starts_over() -> None:
    one = loader()
    expected = list(one)
    next(iter(one))
    assert_same(list(one), expected)


def test_ranks_share_an_epoch_without_overlap() -> None:
    numbers = [
        [n for batch in loader(rank=rank, world_size=2) for n in batch.number.tolist()]
        for rank in (0, 1)
    ]
    assert len(numbers[0]) == len(numbers[1]) == 8
    assert sorted(numbers[0] + numbers[1]) == list(range(16))


def test_an_incomplete_batch_is_kept_only_where_asked() -> None:
    assert [len(b.names) for b in loader(batch_size=8, drop_last=False)] == [8, 8, 4]
    assert [len(b.names) for b in loader(batch_size=8)] == [8, 8]
    assert len(loader(batch_size=8, drop_last=False)) == 3
    with pytest.raises(InvalidOptionError, match="batch_size"):
        PairSampler(pairs=3, batch_size=4)


class Recorder(LightningModule):
    """Learns one number and remembers which pairs it saw."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(()))
        self.seen: list[tuple[int, tuple[int, ...]]] = []

    def training_step(self, batch: PairBatch, _: int) -> torch.Tensor:
        self.seen.append((self.current_epoch, tuple(batch.number.tolist())))
        return (self.weight - batch.source.mean()) ** 2

    def validation_step(self, batch: PairBatch, _: int) -> None:
        assert batch.target.shape[2] == 3

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), lr=0.1)


def trainer(path: Path, **options: object) -> Trainer:
    return Trainer(
        default_root_dir=path, logger=False, enable_progress_bar=False, accelerator="cpu",
        enable_model_summary=False, num_sanity_val_steps=1, **options,  # type: ignore[arg-type]
    )  # fmt: skip


# Lightning 2.6 uses what PyTorch 2.13 deprecates.
@pytest.mark.filterwarnings("ignore:.*LeafSpec:FutureWarning")
@pytest.mark.filterwarnings("ignore:Checkpoint directory .* exists and is not empty")
@pytest.mark.parametrize("steps", [3, 5, 7])
def test_lightning_resumes_in_mid_epoch_without_repeating(tmp_path: Path, steps: int) -> None:
    whole = Recorder()
    trainer(tmp_path, max_epochs=3, enable_checkpointing=False).fit(
        whole, loader(), loader(fixed=True)
    )
    assert len(whole.seen) == 15

    first, second = Recorder(), Recorder()
    keep = ModelCheckpoint(tmp_path, save_last=True, every_n_train_steps=steps)
    trainer(tmp_path, max_steps=steps, callbacks=[keep]).fit(first, loader(), loader(fixed=True))
    keep = ModelCheckpoint(tmp_path, save_last=True, every_n_train_steps=steps)
    trainer(tmp_path, max_epochs=3, callbacks=[keep]).fit(
        second, loader(), loader(fixed=True), ckpt_path=tmp_path / "last.ckpt", weights_only=True
    )
    assert first.seen + second.seen == whole.seen
    assert torch.equal(second.weight, whole.weight)


# Lightning 2.6 uses what PyTorch 2.13 deprecates.
@pytest.mark.filterwarnings("ignore:.*LeafSpec:FutureWarning")
def test_lightning_ends_the_workers(tmp_path: Path) -> None:
    training = loader(workers=1)
    processes: list[Any] = []

    class Watching(Recorder):
        def training_step(self, batch: PairBatch, number: int) -> torch.Tensor:
            processes[:] = training._iterator._workers
            return super().training_step(batch, number)

    trainer(tmp_path, max_epochs=2, enable_checkpointing=False).fit(
        Watching(), training, loader(fixed=True)
    )
    assert len(processes) == 1
    assert training._iterator is None
    assert not processes[0].is_alive()
