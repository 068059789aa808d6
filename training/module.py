"""The LightningModule: encode → solve → lose, stage by stage."""

from __future__ import annotations

import math
from typing import Any, Literal

import torch
from lightning import LightningModule
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor

from model.cloud_function import CloudFunction, pair_mask
from model.kernel import RkhsKernel
from model.se3 import axis_angle_rotation, pose_matrix
from training.alarms import warn_of_collapse
from training.answers import PairAnswer
from training.beginning import Beginning
from training.bilevel import BilevelSolver, InnerSolution
from training.curriculum import Curriculum, Stage
from training.data.pairs import PairBatch
from training.data.seeding import Stream, torch_generator
from training.frame import in_joint_frame, out_of_joint_frame
from training.loss import Alignment, OuterLoss
from training.metrics import RegistrationMetrics

# ρ at which a pair counts half, and how sharply, when pairs are gated by confidence.
_GATE_CENTRE, _GATE_WIDTH = 0.5, 0.1


class EquivAlign(LightningModule):
    """Unsupervised bi-level training of an equivariant encoder (paper, section 4.5).

    Args:
        encoder: name in ``model.encoder.ENCODERS``.
        architecture: the encoder's arguments.
        kernel: name of the feature kernel.
        loss: weight of each outer loss, by its name in ``training.loss.LOSSES``. Terms that use
            the transform which the data pipeline made are self-supervised; the others use only ĥ.
        loss_settings: arguments of single losses.
        bilevel: the inner loop and what of it the gradient sees.
        curriculum: stages in order.
        weight_decay: of AdamW.
        cosine: let the learning rate fall to zero along a half cosine by ``trainer.max_steps``.
        gate_confidence: weigh made pairs, too, by the solver's own ρ in losses that use only ĥ;
            real pairs always are.
        inner_steps: outer steps on each batch, when ``backward`` is ``detached_step``.
        initial: artifact whose encoder, with its weights and kernel, the training continues from;
            ``default`` is the shipped one. The encoder's own arguments are then left out.
        start: pose that the inner loop starts from: ``identity``, or the one that the data give,
            ``given``, where that is a solver's own answer.
        seed: of the losses' random draws.
    """

    def __init__(
        self,
        encoder: str = "vn_graph",
        architecture: dict[str, Any] | None = None,
        kernel: str = "tanh",
        loss: dict[str, float] | None = None,
        loss_settings: dict[str, dict[str, Any]] | None = None,
        bilevel: BilevelSolver | None = None,
        curriculum: list[Stage] | None = None,
        weight_decay: float = 1e-4,
        cosine: bool = False,
        gate_confidence: bool = False,
        inner_steps: int = 20,
        seed: int = 0,
        initial: str | None = None,
        start: Literal["identity", "given"] = "identity",
    ) -> None:
        super().__init__()
        begin = Beginning.of(encoder, architecture or {}, kernel, initial)
        self.encoder_name = begin.encoder_name
        self.architecture = begin.architecture
        self.encoder = begin.encoder
        self.kernel = RkhsKernel(begin.kernel)
        self.start = start
        self.outer_loss = OuterLoss(loss or {"rkhs_distance": 1.0}, loss_settings)
        self.bilevel = bilevel or BilevelSolver()
        self.curriculum = Curriculum(curriculum or [Stage(max_angle=45.0)])
        self.weight_decay = weight_decay
        self.cosine = cosine
        self.gate_confidence = gate_confidence
        self.inner_steps = inner_steps
        self.seed = seed
        self.metrics = RegistrationMetrics()
        self.automatic_optimization = self.bilevel.backward != "detached_step"
        # Lightning clips by itself only where it also steps.
        self.gradient_clip: float | None = 1.0

    def forward(self, x: Tensor, mask: Tensor | None = None) -> Tensor:
        """(B, N, 3) → (B, N, 3, C)."""
        features: Tensor = self.encoder(x, mask)
        return features

    def encode(self, batch: PairBatch) -> tuple[CloudFunction, CloudFunction]:
        """Target and source of a batch in the joint frame as functions in the RKHS."""
        f = self(batch.target, batch.target_mask)
        g = self(batch.source, batch.source_mask)
        return (
            CloudFunction.of(batch.target, f, batch.target_mask, batch.target_labels),
            CloudFunction.of(batch.source, g, batch.source_mask, batch.source_labels),
        )

    def training_step(self, batch: PairBatch, batch_idx: int) -> Tensor | None:
        """One outer step; ``inner_steps`` of them when the inner loop is a detached step."""
        batch = in_joint_frame(batch)
        if not self.automatic_optimization:
            self._detached_steps(batch)
            return None
        target, source = self.encode(batch)
        solution = self.solve(target, source, batch)
        loss, terms = self.outer_loss(self.alignment(batch, target, source, solution))
        self._log_training(loss, terms, solution)
        return loss

    def solve(
        self, target: CloudFunction, source: CloudFunction, batch: PairBatch
    ) -> InnerSolution | None:
        """From no motion: the initial error is what the curriculum put between the clouds.

        Or from the pose that the data give, which has to be a solver's own answer.
        """
        if not self.outer_loss.needs_solution:
            return None
        if self.start == "given":
            start = batch.T_target_source
        else:
            start = torch.eye(4, device=self.device).repeat(len(batch.target), 1, 1)
        return self.bilevel.solve(self.kernel, target, source, start, self.curriculum.stage)

    def alignment(
        self,
        batch: PairBatch,
        target: CloudFunction,
        source: CloudFunction,
        solution: InnerSolution | None,
    ) -> Alignment:
        """What the outer losses see; without a solution ĥ is no motion and counts fully."""
        B = len(batch.target)
        eye = torch.eye(4, device=self.device).expand(B, 4, 4)
        ones = torch.ones(B, device=self.device)
        # The same step draws the same numbers, whether it comes after a resume or not.
        seed = (self.seed * 1_000_003 + self.global_step) * 64 + self.global_rank
        return Alignment(
            kernel=self.kernel,
            target=target,
            source=source,
            T_solved=eye if solution is None else solution.T_target_source,
            lengthscale=ones if solution is None else solution.lengthscale,
            confidence=ones if solution is None else self._confidence(solution, batch),
            T_made=batch.T_target_source,
            is_synthetic=batch.is_synthetic,
            generator=torch.Generator().manual_seed(seed),
        )

    def _detached_steps(self, batch: PairBatch) -> None:
        optimizer = self.optimizers(use_pl_optimizer=True)
        T = torch.eye(4, device=self.device).repeat(len(batch.target), 1, 1)
        for _ in range(self.inner_steps):
            target, source = self.encode(batch)
            solution = self.bilevel.step(self.kernel, target, source, T, self.curriculum.stage)
            T = solution.T_target_source
            loss, terms = self.outer_loss(self.alignment(batch, target, source, solution))
            optimizer.zero_grad()  # type: ignore[union-attr]
            self.manual_backward(loss)
            if self.gradient_clip is not None:
                self.clip_gradients(optimizer, self.gradient_clip, "norm")  # type: ignore[arg-type]
            optimizer.step()  # type: ignore[union-attr]
        self.lr_schedulers().step()  # type: ignore[union-attr, call-arg]
        self._log_training(loss, terms, solution)

    def validation_step(self, batch: PairBatch, batch_idx: int) -> None:
        """Register from the stage's initial error, one start, no search."""
        self._measure(batch)

    def test_step(self, batch: PairBatch, batch_idx: int) -> None:
        """The same on the test pairs."""
        self._measure(batch)

    def predict_step(self, batch: PairBatch, batch_idx: int) -> list[PairAnswer]:
        """Register from no motion; each answer is in the pair's own unit and frame."""
        framed = in_joint_frame(batch)
        target, source = self.encode(framed)
        start = torch.eye(4, device=self.device).repeat(len(batch.target), 1, 1)
        solution = self.bilevel.solve(self.kernel, target, source, start, self.curriculum.stage)
        T = out_of_joint_frame(solution.T_target_source, batch)
        return [
            PairAnswer(name, pose.tolist(), float(similarity))
            for name, pose, similarity in zip(batch.names, T, solution.similarity, strict=True)
        ]

    def _measure(self, batch: PairBatch) -> None:
        batch = in_joint_frame(batch)
        target, source = self.encode(batch)
        stage = self.curriculum.stage
        start = self._start_poses(batch, stage.max_angle)
        solution = self.bilevel.solve(self.kernel, target, source, start, stage)
        T = solution.T_target_source
        moved = source.transformed(T[:, :3, :3], T[:, :3, 3])
        values = self.kernel.terms(target, moved, solution.lengthscale).value
        self.metrics.update(
            T,
            batch.T_target_source,
            solution.similarity,
            solution.lengthscale,
            target,
            values,
            pair_mask(target, source),
        )

    def _start_poses(self, batch: PairBatch, angle: float) -> Tensor:
        """The true poses, turned about the source's centroid by the stage's whole angle.

        A pair's axis follows from its number, so it is the same in every batch and process.
        """
        axis = torch.stack(
            [
                torch.randn(3, generator=torch_generator(self.seed, Stream.MOTION, number))
                for number in batch.number.tolist()
            ]
        ).to(self.device)
        turn = torch.full((len(axis),), math.radians(angle), device=self.device)
        R = axis_angle_rotation(axis, turn)
        # Both clouds are centred, so the source's centroid moves to the true translation.
        centre = batch.T_target_source[:, :3, 3]
        return pose_matrix(R, centre - (R @ centre[..., None])[..., 0]) @ batch.T_target_source

    def on_validation_epoch_end(self) -> None:
        """Log the metrics, raise collapse alarms, let the curriculum judge."""
        values = self._log_metrics("val")
        self.log("val/score", self.curriculum.index + values["recall_5deg"], sync_dist=True)
        warn_of_collapse(values, self.curriculum.stage, self.bilevel.inner_loop)
        training = self.trainer.state.fn == "fit" and not self.trainer.sanity_checking
        if training and self.curriculum.judge(float(values["recall_5deg"])):
            self._enter_stage()

    def on_test_epoch_end(self) -> None:
        """Log the metrics."""
        self._log_metrics("test")

    def _log_metrics(self, subset: str) -> dict[str, Tensor]:
        values = self.metrics.compute()
        self.metrics.reset()
        named = {f"{subset}/{name}": value for name, value in values.items()}
        # Already over all processes; the mean of equal values changes nothing.
        self.log_dict(named, sync_dist=True)
        return values

    def on_fit_start(self) -> None:
        """Tell the data the present stage's angle."""
        self._enter_stage()

    def on_train_batch_start(self, batch: PairBatch, batch_idx: int) -> None:
        """See whether the steps so far end the stage; the next batch then has its angle."""
        if self.curriculum.reach(self.global_step):
            self._enter_stage()

    def _enter_stage(self) -> None:
        stage = self.curriculum.stage
        data = getattr(self.trainer, "datamodule", None)
        if data is not None:
            data.max_angle = stage.max_angle

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """AdamW; the rate follows the stage and, if asked for, a half cosine."""
        base = self.curriculum.stages[0].learning_rate
        optimizer = torch.optim.AdamW(self.parameters(), lr=base, weight_decay=self.weight_decay)
        total = self.trainer.max_steps

        def factor(step: int) -> float:
            share = min(1.0, step / total) if self.cosine and total > 0 else 0.0
            rate = self.curriculum.stage.learning_rate / base
            return rate * 0.5 * (1.0 + math.cos(math.pi * share))

        scheduler = torch.optim.lr_scheduler.LambdaLR(optimizer, factor)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler, "interval": "step"},
        }

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the place in the curriculum, and what an export needs, as plain values."""
        checkpoint["curriculum"] = self.curriculum.state_dict()
        checkpoint["equivalign"] = {
            "encoder": self.encoder_name,
            "architecture": self.architecture,
            "kernel": self.kernel.name,
            "loss": self.outer_loss.weights,
            "transforms_used": self.outer_loss.transforms_used(),
            "inner_loop": self.bilevel.inner_loop,
            "backward": self.bilevel.backward,
            "curriculum_angles": [stage.max_angle for stage in self.curriculum.stages],
            "curriculum_stage": self.curriculum.index + 1,
            "seed": self.seed,
        }

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Go on at the place in the curriculum."""
        self.curriculum.load_state_dict(checkpoint["curriculum"])

    def _confidence(self, solution: InnerSolution, batch: PairBatch) -> Tensor:
        """(B,) from 0 to 1: how far ĥ may be believed, by the solver's own ρ."""
        gate = torch.sigmoid((solution.similarity - _GATE_CENTRE) / _GATE_WIDTH)
        if self.gate_confidence:
            return gate
        return torch.where(batch.is_synthetic, torch.ones_like(gate), gate)

    def _log_training(
        self, loss: Tensor, terms: dict[str, Tensor], solution: InnerSolution | None
    ) -> None:
        logged = {f"train/{name}": value.detach() for name, value in terms.items()}
        logged["train/loss"] = loss.detach()
        if solution is not None:
            logged["train/similarity"] = solution.similarity.mean()
            logged["train/lengthscale"] = solution.lengthscale.detach().mean()
        stage = self.curriculum.stage
        logged["curriculum/stage"] = torch.tensor(float(self.curriculum.index))
        logged["curriculum/max_angle"] = torch.tensor(stage.max_angle)
        self.log_dict(logged)
        self.log("loss", loss.detach(), prog_bar=True, logger=False)
        self.log("angle", stage.max_angle, prog_bar=True, logger=False)
