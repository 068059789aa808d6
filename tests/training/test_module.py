from __future__ import annotations

import json
import math

import pytest
import torch
from small_run import CONFIGS, QUIET, small

from model import Registrar
from model.cloud_function import CloudFunction
from model.exceptions import ArtifactFormatError, ArtifactNotFoundError, InvalidOptionError
from model.se3 import rotation_angle
from training.bilevel import BilevelSolver, InnerSolution
from training.cli import fit, validate
from training.curriculum import Stage
from training.data.motion import Motion
from training.data.pairs import PairBatch, collate, pair_of_shape
from training.data.perturbation import Perturbation
from training.export import export_command
from training.frame import in_joint_frame
from training.loss import LOSSES, OuterLoss
from training.loss.spread import participation_ratio
from training.module import EquivAlign

SMALL = {"channels": 8, "channels_out": 4, "invariants": 8, "radii": [0.15, 0.3], "layers": 1}


@pytest.fixture
def batch(shapes) -> PairBatch:
    perturbation = Perturbation(sigma=(0.0, 0.01), target_points=(80, 100), source_points=(80, 100))
    generator = torch.Generator().manual_seed(0)
    motion = Motion(rotation="exact_angle", max_angle=20.0, max_translation=0.3)
    pairs = [
        pair_of_shape(shapes[i], perturbation, generator, i).moved(motion.draw(generator))
        for i in range(3)
    ]
    return collate(pairs)


def module(loss: dict[str, float], bilevel: BilevelSolver | None = None) -> EquivAlign:
    torch.manual_seed(0)
    return EquivAlign(
        architecture=SMALL,
        loss=loss,
        bilevel=bilevel or BilevelSolver(iterations=4),
        curriculum=[Stage(max_angle=20.0, lengthscale=0.3, lengthscale_bounds=(0.1, 1.0))],
    )


def gradient(model: EquivAlign, batch: PairBatch) -> torch.Tensor:
    batch = in_joint_frame(batch)
    target, source = model.encode(batch)
    solution = model.solve(target, source, batch)
    loss, _ = model.outer_loss(model.alignment(batch, target, source, solution))
    model.zero_grad()
    loss.backward()
    return torch.cat([p.grad.flatten() for p in model.encoder.parameters() if p.grad is not None])


def test_the_joint_frame_holds_both_clouds_and_the_pose_follows(batch):
    framed = in_joint_frame(batch)
    for points, mask in ((framed.target, framed.target_mask), (framed.source, framed.source_mask)):
        centre = (points * mask[..., None]).sum(1) / mask.sum(1, keepdim=True)
        assert centre.abs().max() < 1e-5
        assert points.norm(dim=-1).max() <= 1.0 + 1e-5
    # One scale for both, and the residual between two given points shrinks by it.
    scale = batch.target[:, 0].sub(batch.target[:, 1]).norm(dim=-1) / framed.target[:, 0].sub(
        framed.target[:, 1]
    ).norm(dim=-1)
    torch.testing.assert_close(residual(framed) * scale, residual(batch), rtol=1e-3, atol=1e-5)


def residual(batch: PairBatch) -> torch.Tensor:
    """Distance of the first source point, truly moved, from the first target point."""
    T = batch.T_target_source
    moved = (T[:, :3, :3] @ batch.source[:, 0, :, None])[..., 0] + T[:, :3, 3]
    return (moved - batch.target[:, 0]).norm(dim=-1)


@pytest.mark.parametrize("backward", ["envelope", "unrolled", "detached_step"])
@pytest.mark.parametrize("loss", [name for name in LOSSES if LOSSES[name]().uses_solution])
def test_true_poses_do_not_enter_the_gradient_of_a_bilevel_loss(loss, backward, batch):
    model = module({loss: 1.0}, BilevelSolver(iterations=4, backward=backward))
    noise = Motion(rotation="haar", max_translation=1.0)
    generator = torch.Generator().manual_seed(9)
    replaced = batch._replace(
        T_target_source=torch.stack([noise.draw(generator) for _ in range(3)])
    )
    true, noisy = gradient(model, batch), gradient(model, replaced)
    assert true.abs().sum() > 0
    assert torch.equal(true, noisy)


@pytest.mark.parametrize("loss", LOSSES)
def test_every_loss_says_which_pose_it_uses_and_has_a_finite_gradient(loss, batch):
    model = module({loss: 1.0})
    assert torch.isfinite(gradient(model, batch)).all()
    real = batch._replace(is_synthetic=torch.zeros(3, dtype=torch.bool))
    used = model.outer_loss.transforms_used()[loss]
    on_real = gradient(model, real)
    if used == "self-made transform":
        assert on_real.abs().sum() == 0.0
    else:
        assert used == ("no pose" if loss == "spread_floor" else "solved pose only")
        assert on_real.abs().sum() > 0.0


def test_the_spread_floor_asks_for_more_only_below_it():
    points = torch.randn(2, 50, 3, generator=torch.Generator().manual_seed(0))
    alike = CloudFunction.of(points, points[..., None].repeat(1, 1, 1, 5))
    apart = CloudFunction.of(points, torch.randn(2, 50, 3, 5, generator=torch.Generator()))
    torch.testing.assert_close(participation_ratio(alike), torch.ones(2))
    assert (participation_ratio(apart) > 4.0).all()


def test_real_pairs_count_by_the_solvers_confidence_and_made_ones_when_asked(batch):
    model = module({"rkhs_distance": 1.0})
    solution = InnerSolution(
        torch.eye(4).repeat(3, 1, 1), torch.ones(3), torch.tensor([0.1, 0.5, 0.9])
    )

    def confidence(real: bool) -> torch.Tensor:
        pairs = batch._replace(is_synthetic=torch.full((3,), not real))
        return model.alignment(pairs, *model.encode(pairs), solution).confidence

    gated = confidence(real=True)
    assert gated[0] < 0.05
    assert gated[2] > 0.95
    assert torch.equal(confidence(real=False), torch.ones(3))
    model.gate_confidence = True
    assert torch.equal(confidence(real=False), gated)


def test_unrolling_differs_from_the_envelope_before_the_optimum(batch):
    envelope = gradient(module({"rkhs_distance": 1.0}, BilevelSolver(iterations=1)), batch)
    unrolled = gradient(
        module({"rkhs_distance": 1.0}, BilevelSolver(iterations=1, backward="unrolled")), batch
    )
    assert (envelope - unrolled).norm() > 1e-3 * envelope.norm()


def test_the_envelope_gradient_is_exact_at_an_optimum(batch):
    """dL/dθ through the inner loop's last steps vanishes there: both gradients agree."""
    solver = {"inner_loop": "gradient", "iterations": 600}
    envelope = gradient(module({"rkhs_distance": 1.0}, BilevelSolver(**solver)), batch)
    unrolled = gradient(
        module({"rkhs_distance": 1.0}, BilevelSolver(**solver, backward="unrolled")), batch
    )
    cosine = torch.nn.functional.cosine_similarity(envelope, unrolled, dim=0)
    assert cosine > 0.99


def test_start_poses_are_wrong_by_the_stages_angle(batch):
    framed = in_joint_frame(batch)
    model = module({"rkhs_distance": 1.0})
    start = model._start_poses(framed, 20.0)
    angle = rotation_angle(start[:, :3, :3], framed.T_target_source[:, :3, :3])
    torch.testing.assert_close(angle, torch.full((3,), math.radians(20.0)), atol=1e-4, rtol=0)


def test_unknown_losses_are_refused():
    with pytest.raises(InvalidOptionError, match="rkhs_distance"):
        OuterLoss({"chamfer": 1.0})
    with pytest.raises(InvalidOptionError, match="no loss"):
        OuterLoss({})
    with pytest.raises(InvalidOptionError, match="loss_settings"):
        OuterLoss({"rkhs_distance": 1.0}, {"rkhs_distance": {"power": 2}})


@QUIET
@pytest.mark.parametrize("backward", ["unrolled", "detached_step"])
def test_the_command_trains_by_every_kind_of_gradient(backward: str, tmp_path):
    arguments = [*small(CONFIGS / "quickstart.yaml"), "--trainer.default_root_dir", str(tmp_path)]
    arguments += ["--model.bilevel.backward", backward, "--model.loss", "{rkhs_distance: 1.0}"]
    arguments += ["--trainer.max_steps", "4", "--model.inner_steps", "2"]
    arguments += ["--data.pairs_per_epoch", "8", "--data.evaluation_pairs", "4"]
    assert fit(arguments) == 0
    (checkpoint,) = tmp_path.rglob("last.ckpt")
    state = torch.load(checkpoint, weights_only=True)
    assert state["equivalign"]["backward"] == backward
    # Four steps of one batch each, or two batches of two; an epoch has two batches.
    assert state["global_step"] == (2 if backward == "unrolled" else 4)


@QUIET
def test_fit_validate_export_and_serve_the_same_features(tmp_path, batch, capsys):
    arguments = [*small(CONFIGS / "quickstart.yaml"), "--trainer.default_root_dir", str(tmp_path)]
    arguments += ["--trainer.max_steps", "2", "--data.pairs_per_epoch", "8"]
    arguments += ["--data.evaluation_pairs", "4", "--data.batch_size", "4"]
    assert fit(arguments) == 0
    (checkpoint,) = tmp_path.rglob("last.ckpt")
    assert validate([*arguments, "--ckpt_path", str(checkpoint)]) == 0
    assert export_command([str(checkpoint), str(tmp_path / "artifact")]) == 0
    assert "2 steps" in capsys.readouterr().out
    summary = json.loads((tmp_path / "artifact" / "artifact.json").read_text())["training"]
    assert summary["transforms_used"]["feature_contrast"] == "self-made transform"
    state = torch.load(checkpoint, weights_only=True)["state_dict"]
    served = Registrar.load(tmp_path / "artifact").artifact.weights
    for name, value in served.items():
        assert torch.equal(value, state[f"encoder.{name}"])


def test_export_refuses_what_fit_did_not_write(tmp_path):
    with pytest.raises(ArtifactNotFoundError, match="no such checkpoint"):
        export_command([str(tmp_path / "none.ckpt"), str(tmp_path / "artifact")])
    torch.save({"state_dict": {}}, tmp_path / "foreign.ckpt")
    with pytest.raises(ArtifactFormatError, match="not a checkpoint"):
        export_command([str(tmp_path / "foreign.ckpt"), str(tmp_path / "artifact")])
    (tmp_path / "text.ckpt").write_text("hello")
    with pytest.raises(ArtifactFormatError, match="not a checkpoint"):
        export_command([str(tmp_path / "text.ckpt"), str(tmp_path / "artifact")])
    assert not (tmp_path / "artifact").exists()
