# SPDX-License-Identifier: MIT
"""One step of training: forward, loss, backward, update."""

from __future__ import annotations

import copy
import logging
import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.losses import SegmentationLoss, Whole
from salsanext_cli.training.precision import autocast, dtype_of, scaler
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.schedule import learning_rate

DROPOUT = 2
"""What a generator is for; part of its seed, beside those of `plan`."""

log = logging.getLogger(__name__)


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


def shared(module: nn.Module, device: torch.device, group: ProcessGroup) -> nn.Module:
    """Return what to call in training: the module, or what adds up its gradient over a team."""
    if group.size == 1:
        return module
    if device.type == "cuda":
        module = nn.SyncBatchNorm.convert_sync_batchnorm(module)  # type: ignore[no-untyped-call]
        return DistributedDataParallel(module, [device])
    if group.is_main and any(isinstance(layer, nn.BatchNorm2d) for layer in module.modules()):
        log.warning("on CPUs batch norm has the statistics of each worker's share of a batch")
    return DistributedDataParallel(module)


@dataclass(slots=True, eq=False)
class Learner:
    """What changes during training.

    Attributes
    ----------
    recipe : Recipe
    module : SegmentationNetwork
        Being trained.
    loss : SegmentationLoss
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
        What is called in training: the module, wrapped for a team.
    """

    recipe: Recipe
    module: SegmentationNetwork
    loss: SegmentationLoss
    optimiser: torch.optim.Optimizer
    average: SegmentationNetwork
    scaler: torch.amp.GradScaler
    dtype: torch.dtype
    device: torch.device
    group: ProcessGroup
    forward: nn.Module

    @classmethod
    def of(
        cls,
        module: SegmentationNetwork,
        recipe: Recipe,
        weights: Tensor,
        device: torch.device,
        group: ProcessGroup = SINGLE_PROCESS,
    ) -> Learner:
        """Prepare a module for training with class weights (C,)."""
        module = module.to(device)
        if device.type == "cuda":
            module = module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        average = copy.deepcopy(module).eval() if recipe.average else module
        loss = SegmentationLoss(weights, recipe.lovasz, recipe.label_smoothing).to(device)
        forward = shared(module, device, group)
        optimiser, dtype = build_optimiser(module, recipe), dtype_of(recipe.precision, device)
        scale = scaler(dtype, device)
        return cls(recipe, module, loss, optimiser, average, scale, dtype, device, group, forward)

    @property
    def network(self) -> nn.Module:
        """What is called in training, by this worker alone."""
        if not isinstance(self.forward, DistributedDataParallel):
            return self.forward
        own: nn.Module = self.forward.module
        return own

    def step(self, images: Tensor, truth: Tensor, step: int, steps_per_epoch: int) -> float:
        """Learn from one batch and return its loss; NaN if it or its gradient is not finite.

        Then no weight has changed. (Gradients that overflow in float16 are no mistake: the scaler
        leaves the step out.) In a team the images are a worker's share of the batch, and the loss
        is that of all.

        Parameters
        ----------
        images : (B, 5, H, W) float32
        truth : (B, H, W) uint8
        step : int
            Of the whole training, from 0; decides learning rate and dropout.
        steps_per_epoch : int
        """
        self.optimiser.zero_grad()
        loss = float(self._gradient(images, truth, step))
        return loss if math.isfinite(loss) and self._update(step, steps_per_epoch) else math.nan

    def _gradient(self, images: Tensor, truth: Tensor, step: int) -> Tensor:
        """Add up the gradient of a batch, part by part, and return its loss."""
        # On CPUs the gradient of the weights is a third slower with channels last.
        layout = torch.channels_last if self.device.type == "cuda" else torch.contiguous_format
        truth = truth.to(self.device, non_blocking=True)
        parts = self._parts(images.shape[3])
        whole = self._whole(truth, parts)
        losses = []
        self.module.train()
        # Seeding every step makes it a function of its number, so that training can be resumed.
        with torch.random.fork_rng([self.device] if self.device.type == "cuda" else []):
            torch.manual_seed(self._seed(step))
            pairs = zip(images.tensor_split(parts), truth.tensor_split(parts), strict=True)
            for part, (some, labels) in enumerate(pairs, 1):
                some = some.to(self.device, memory_format=layout, non_blocking=True)
                with self._summing(at_last=part == parts):
                    with autocast(self.dtype, self.device):
                        loss = self.loss(self.forward(some), labels, whole)
                    # The team's gradient is a mean over its workers, and the sum is wanted.
                    self.scaler.scale(loss * self.group.size).backward()
                losses.append(loss.detach())
        return self.group.sum(torch.stack(losses).sum())

    def _seed(self, step: int) -> int:
        """Return a seed of what dropout draws, unlike for every training, step and worker."""
        source = np.random.SeedSequence((self.recipe.seed, DROPOUT, step, self.group.rank))
        return int(source.generate_state(1)[0])

    def _parts(self, width: int) -> int:
        """Return into how many parts a batch is cut, by every worker alike.

        Whole circles after windows are cut into more, so that a part holds no more columns than one
        of windows does, or a single circle.
        """
        recipe = self.recipe
        fewest, most = recipe.batch // self.group.size, -(-recipe.batch // self.group.size)
        parts = min(recipe.accumulate, fewest)
        if 0 < recipe.crop_width < width:
            images = max(1, -(-most // parts) * recipe.crop_width // width)
            parts = min(-(-most // images), fewest)
        return parts

    def _whole(self, truth: Tensor, parts: int) -> Whole | None:
        if parts * self.group.size == 1:
            return None
        return Whole(self.group.sum(self.loss.weight_of(truth)), parts, self.group)

    def _summing(self, *, at_last: bool) -> AbstractContextManager[None]:
        """Exchange gradients with the team after the last part only."""
        if isinstance(self.forward, DistributedDataParallel) and not at_last:
            return self.forward.no_sync()
        return nullcontext()

    def _update(self, step: int, steps_per_epoch: int) -> bool:
        """Move the weights; return False, and do not, if the gradient is not finite."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.recipe, step, steps_per_epoch)
        self.scaler.unscale_(self.optimiser)
        longest = self.recipe.clip_gradient or math.inf
        length = nn.utils.clip_grad_norm_(self.module.parameters(), longest)
        if not self.scaler.is_enabled() and not length.isfinite():
            return False
        self.scaler.step(self.optimiser)
        self.scaler.update()
        if self.average is not self.module:
            update_average(self.average, self.module, self.recipe.average, step)
        return True
