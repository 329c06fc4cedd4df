# SPDX-License-Identifier: MIT
"""One step of training: forward, loss, backward, update."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.training.losses import SegmentationLoss
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.schedule import learning_rate


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
    device : torch.device
        Where all of them are.
    """

    recipe: Recipe
    module: SegmentationNetwork
    loss: SegmentationLoss
    optimiser: torch.optim.Optimizer
    average: SegmentationNetwork
    device: torch.device

    @classmethod
    def of(
        cls, module: SegmentationNetwork, recipe: Recipe, weights: Tensor, device: torch.device
    ) -> Learner:
        """Prepare a module for training with class weights (C,)."""
        module = module.to(device)
        if device.type == "cuda":
            module = module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        average = copy.deepcopy(module).eval() if recipe.average else module
        loss = SegmentationLoss(weights, recipe.lovasz).to(device)
        return cls(recipe, module, loss, build_optimiser(module, recipe), average, device)

    def step(self, images: Tensor, truth: Tensor, step: int, steps_per_epoch: int) -> float:
        """Learn from one batch and return its loss; one that is not finite changes nothing.

        Parameters
        ----------
        images : (B, 5, H, W) float32
        truth : (B, H, W) uint8
        step : int
            Of the whole training, from 0; decides learning rate and dropout.
        steps_per_epoch : int
        """
        # On CPUs the gradient of the weights is a third slower with channels last.
        layout = torch.channels_last if self.device.type == "cuda" else torch.contiguous_format
        images = images.to(self.device, memory_format=layout)
        half = torch.autocast(self.device.type, torch.bfloat16, self.device.type == "cuda")
        devices = [self.device] if self.device.type == "cuda" else []
        self.module.train()
        # Seeding every step makes it a function of its number, so that training can be resumed.
        with torch.random.fork_rng(devices), half:
            torch.manual_seed(self.recipe.seed + step)
            loss = self.loss(self.module(images), truth.to(self.device))
        value = float(loss.detach())
        if math.isfinite(value):
            self._update(loss, step, steps_per_epoch)
        return value

    def _update(self, loss: Tensor, step: int, steps_per_epoch: int) -> None:
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.recipe, step, steps_per_epoch)
        self.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        if self.recipe.clip_gradient:
            nn.utils.clip_grad_norm_(self.module.parameters(), self.recipe.clip_gradient)
        self.optimiser.step()
        if self.average is not self.module:
            update_average(self.average, self.module, self.recipe.average, step)
