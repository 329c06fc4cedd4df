# SPDX-License-Identifier: MIT
"""One step of training: forward, loss, backward, update."""

from __future__ import annotations

import copy
import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.training.heteroscedastic import HeteroscedasticLoss, MomentNetwork, with_moments
from salsanext_cli.training.losses import SegmentationLoss, Whole
from salsanext_cli.training.precision import autocast, dtype_of, scaler
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.schedule import learning_rate
from salsanext_cli.training.team import ALONE, Team

STRIDE = 1 << 24
"""Between the seeds of two workers: more than a training has steps, and within the 32 bits that
torch takes of a seed on CPUs."""


def build_optimiser(module: nn.Module, recipe: Recipe) -> torch.optim.Optimizer:
    """Return the recipe's optimiser of all parameters."""
    parameters = list(module.parameters())
    if recipe.optimiser == "sgd":
        return torch.optim.SGD(
            parameters,
            lr=recipe.learning_rate,
            momentum=recipe.momentum,
            weight_decay=recipe.weight_decay,
        )
    return torch.optim.AdamW(
        parameters,
        lr=recipe.learning_rate,
        betas=(recipe.momentum, 0.999),
        weight_decay=recipe.weight_decay,
    )


@torch.no_grad()
def update_average(average: nn.Module, module: nn.Module, decay: float, step: int) -> None:
    """Move the running average towards the module; early steps count more, so that none lingers.

    Batch-norm statistics are averaged like weights.
    """
    decay = min(decay, (1 + step) / (10 + step))
    for kept, new in zip(average.state_dict().values(), module.state_dict().values(), strict=True):
        if kept.is_floating_point():
            kept.lerp_(new, 1 - decay)
        else:
            kept.copy_(new)


def shared(module: nn.Module, device: torch.device, team: Team) -> nn.Module:
    """Return what to call in training: the module, or what adds up its gradient over a team.

    Each worker of a `MomentNetwork` normalises by its own share, since what normalises by those of
    all takes nothing but tensors.
    """
    if team.size == 1:
        return module
    if device.type == "cuda" and not isinstance(module, MomentNetwork):
        module = nn.SyncBatchNorm.convert_sync_batchnorm(module)  # type: ignore[no-untyped-call]
    return DistributedDataParallel(module, [device] if device.type == "cuda" else None)


@dataclass(slots=True, eq=False)
class Learner:
    """What changes during training.

    Attributes
    ----------
    recipe : Recipe
    module : SegmentationNetwork
        Being trained.
    loss : SegmentationLoss or HeteroscedasticLoss
        Takes what `forward` returns.
    optimiser : torch.optim.Optimizer
    average : SegmentationNetwork
        What is validated and kept: the running average of the weights, or the module itself.
    scaler : torch.amp.GradScaler
        Keeps small gradients of float16 from vanishing; does nothing in other types.
    dtype : torch.dtype
        What the network computes in.
    device : torch.device
        Where all of them are.
    team : Team
        Who else trains the module.
    forward : nn.Module
        What is called in training: the module, wrapped for moments and for a team.
    """

    recipe: Recipe
    module: SegmentationNetwork
    loss: SegmentationLoss | HeteroscedasticLoss
    optimiser: torch.optim.Optimizer
    average: SegmentationNetwork
    scaler: torch.amp.GradScaler
    dtype: torch.dtype
    device: torch.device
    team: Team
    forward: nn.Module

    @classmethod
    def of(
        cls,
        module: SegmentationNetwork,
        recipe: Recipe,
        weights: Tensor,
        device: torch.device,
        team: Team = ALONE,
    ) -> Learner:
        """Prepare a module for training with class weights (C,)."""
        module = module.to(device)
        if device.type == "cuda":
            module = module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        average = copy.deepcopy(module).eval() if recipe.average else module
        loss, forward = with_moments(SegmentationLoss(weights, recipe.lovasz), module, recipe)
        loss, forward = loss.to(device), shared(forward, device, team)
        # Variances are too small for shorter types.
        precision = "float32" if recipe.heteroscedastic else recipe.precision
        optimiser, dtype = build_optimiser(module, recipe), dtype_of(precision, device)
        scale = scaler(dtype, device)
        return cls(recipe, module, loss, optimiser, average, scale, dtype, device, team, forward)

    def step(self, images: Tensor, truth: Tensor, step: int, steps_per_epoch: int) -> float:
        """Learn from one batch and return its loss; one that is not finite changes nothing.

        In a team the images are a worker's share of the batch, and the loss is that of all.

        Parameters
        ----------
        images : (B, 5, H, W) float32
            As `Samples` of the recipe gives them: with their variances, (B, 10, H, W).
        truth : (B, H, W) uint8
        step : int
            Of the whole training, from 0; decides learning rate and dropout.
        steps_per_epoch : int
        """
        self.optimiser.zero_grad()
        loss = float(self._gradient(images, truth, step))
        if math.isfinite(loss):
            self._update(step, steps_per_epoch)
        return loss

    def _gradient(self, images: Tensor, truth: Tensor, step: int) -> Tensor:
        """Add up the gradient of a batch, part by part, and return its loss."""
        # On CPUs the gradient of the weights is a third slower with channels last.
        layout = torch.channels_last if self.device.type == "cuda" else torch.contiguous_format
        truth = truth.to(self.device)
        parts = min(self.recipe.accumulate, len(images))
        whole = self._whole(truth, parts)
        losses = []
        self.module.train()
        # Seeding every step makes it a function of its number, so that training can be resumed.
        with torch.random.fork_rng([self.device] if self.device.type == "cuda" else []):
            torch.manual_seed(self.recipe.seed + step + self.team.rank * STRIDE)
            pairs = zip(images.tensor_split(parts), truth.tensor_split(parts), strict=True)
            for part, (some, labels) in enumerate(pairs, 1):
                some = some.to(self.device, memory_format=layout)
                with self._summing(at_last=part == parts):
                    with autocast(self.dtype, self.device):
                        loss = self.loss(self.forward(some), labels, whole)
                    # The team's gradient is a mean over its workers, and the sum is wanted.
                    self.scaler.scale(loss * self.team.size).backward()
                losses.append(loss.detach())
        return self.team.sum(torch.stack(losses).sum())

    def _whole(self, truth: Tensor, parts: int) -> Whole | None:
        if parts * self.team.size == 1:
            return None
        weight, pixels = self.team.sum(self.loss.size(truth))
        return Whole(weight, pixels, parts, self.team)

    def _summing(self, *, at_last: bool) -> AbstractContextManager[None]:
        """Exchange gradients with the team after the last part only."""
        if isinstance(self.forward, DistributedDataParallel) and not at_last:
            return self.forward.no_sync()
        return nullcontext()

    def _update(self, step: int, steps_per_epoch: int) -> None:
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.recipe, step, steps_per_epoch)
        if self.recipe.clip_gradient:
            self.scaler.unscale_(self.optimiser)
            nn.utils.clip_grad_norm_(self.module.parameters(), self.recipe.clip_gradient)
        self.scaler.step(self.optimiser)
        self.scaler.update()
        if self.average is not self.module:
            update_average(self.average, self.module, self.recipe.average, step)
