# SPDX-License-Identifier: MIT
"""Network in training, its optimiser and its steps: forward, loss, backward, update."""

import copy
import math
from contextlib import nullcontext

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import SGD, AdamW, Optimizer

from salsanext_cli.core.engines.device import bfloat16_instructions, choose_precision
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.engines.torch_backend import keep_ends_in_float32, set_up_cuda
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.io.weights.loading import network_of_module
from salsanext_cli.training.data.targets import ClassSets
from salsanext_cli.training.distributed import (
    SINGLE_PROCESS,
    ProcessGroup,
    agreed_precision,
    data_parallel,
)
from salsanext_cli.training.fused_step import is_fused, skip_step
from salsanext_cli.training.losses import SegmentationLoss
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.running_average import RunningAverage

BFLOAT16_CAPABILITY = 8  # Lowest compute capability (major) with bfloat16: Ampere
DROPOUT = 2  # Part of the seed of dropout; `dataset` has the others
ONE_CYCLE_START = 1 / 25  # First learning rate of a one-cycle schedule, as a share of its peak
ONE_CYCLE_END = 1 / 250_000  # Last learning rate


def fastest_precision(device: torch.device) -> str:
    """Return the number type that a device computes fastest in."""
    if device.type != "cuda":
        return "bfloat16" if bfloat16_instructions() else "float32"
    major, _ = torch.cuda.get_device_capability(device)
    return "bfloat16" if major >= BFLOAT16_CAPABILITY else "float16"


def validation_precision(device: torch.device) -> str:
    """Return the number type of a validation: on a GPU that of `predict`, on a CPU float32."""
    return "float32" if device.type == "cpu" else choose_precision("auto", str(device), "torch")


def common_precision(device: torch.device, group: ProcessGroup) -> str:
    """Return the number type that suits the devices of all workers; float32 if they differ."""
    return agreed_precision(fastest_precision(device), device, group)


class Learner:
    """Everything that changes during training: network, running average, optimiser, scaler.

    `average` is validated and saved: the running average of the weights of `module`, or the module
    itself. `forward` is the module, wrapped if several workers train it.
    """

    def __init__(
        self,
        module: SegmentationNetwork,
        recipe: Recipe,
        weights: Tensor,
        device: torch.device,
        group: ProcessGroup = SINGLE_PROCESS,
        sets: ClassSets = (),
    ) -> None:
        if device.type == "cuda":
            set_up_cuda()  # As for validation, so that a resumed training has the same arithmetic
        dtype: torch.dtype = getattr(torch, recipe.precision)
        # In float32 on CPUs channels last gains nothing, or is slower.
        plain = device.type == "cpu" and dtype is torch.float32
        self.layout = torch.contiguous_format if plain else torch.channels_last
        module = module.to(device).to(memory_format=self.layout)  # type: ignore[call-overload]
        if dtype is not torch.float32:
            keep_ends_in_float32(module)
        self.recipe = recipe
        self.module = module
        self.device = device
        self.group = group
        self.average = module
        self.running_average: RunningAverage | None = None
        if recipe.average:
            self.average = copy.deepcopy(module).eval()
            self.running_average = RunningAverage(self.average, module, recipe.average)
        self.loss = SegmentationLoss(weights, recipe.lovasz, sets).to(device)
        self.forward = data_parallel(module, device, group)
        self.optimiser = build_optimiser(module, recipe, fused=device.type == "cuda")
        self.autocast = torch.autocast(device.type, dtype, enabled=dtype is not torch.float32)
        self.scaler = torch.amp.GradScaler(device.type, enabled=dtype is torch.float16)

    def network(self, card: WeightsCard) -> Network:
        """Return the network of the present weights, to validate it."""
        return network_in_training(self.average.eval(), card, self.device)

    def step(self, images: Tensor, truth: Tensor, step: int, steps_per_epoch: int) -> Tensor:
        """Learn from a worker's images (B, 5, H, W), and truth (B, H, W) uint8.

        Return the loss of all workers, 0-d on the device, without waiting for it. It is NaN, and no
        weight changes, if loss or gradient is not finite. In float16 the scaler skips steps whose
        gradient overflows. The number of the step, from 0, determines learning rate and dropout.
        """
        self.optimiser.zero_grad()
        loss = self._gradient(images, truth, step)
        return torch.where(self._update(loss, step, steps_per_epoch), loss, math.nan)

    def _gradient(self, images: Tensor, truth: Tensor, step: int) -> Tensor:
        """Add up the gradient of a batch, part by part, and return its loss."""
        parts = min(self.recipe.accumulate, self.recipe.batch // self.group.size)
        total = None
        # A batch of workers is in pinned memory, that of a device is there.
        truth = truth.to(self.device, non_blocking=True)
        if parts * self.group.size > 1:
            total = self.group.sum(self.loss.weights[truth.long()].sum())
        losses = []
        self.module.train()
        # Seeded, every step is a function of its number, so that training can be resumed.
        with torch.random.fork_rng([self.device] if self.device.type == "cuda" else []):
            source = np.random.SeedSequence((self.recipe.seed, DROPOUT, step, self.group.rank))
            seed_dropout(int(source.generate_state(1)[0]), self.device)
            pairs = zip(images.tensor_split(parts), truth.tensor_split(parts), strict=True)
            for number, (part_images, labels) in enumerate(pairs, 1):
                inputs = part_images.to(self.device, memory_format=self.layout, non_blocking=True)
                # Workers exchange gradients after the last part only.
                no_sync = getattr(self.forward, "no_sync", nullcontext)
                with no_sync() if number < parts else nullcontext():
                    counts = self._images_of_workers(parts, number)
                    with self.autocast:
                        logits = self.forward(inputs)
                        loss = self.loss(logits, labels, total, parts, self.group, counts)
                    # Gradients are averaged over the workers, but must be summed.
                    self.scaler.scale(loss * self.group.size).backward()
                losses.append(loss.detach())
        return self.group.sum(torch.stack(losses).sum())

    def _images_of_workers(self, parts: int, number: int) -> list[int]:
        """Return how many images each worker has in the number-th part of a batch, from 1."""
        counts = []
        for rank in range(self.group.size):
            images = len(range(rank, self.recipe.batch, self.group.size))
            # `tensor_split` puts one image more into the first parts.
            counts.append(images // parts + (number <= images % parts))
        return counts

    def _update(self, loss: Tensor, step: int, steps_per_epoch: int) -> Tensor:
        """Update the weights if loss and gradient are finite; return whether they are, 0-d bool."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.recipe, step, steps_per_epoch)
        self.scaler.unscale_(self.optimiser)
        max_norm = self.recipe.clip_gradient or math.inf
        norm = nn.utils.clip_grad_norm_(self.module.parameters(), max_norm)
        # In float16 an overflow of the gradient is not a failure: the scaler skips the step.
        finite = loss.isfinite() if self.scaler.is_enabled() else (loss + norm).isfinite()
        # A fused optimiser skips the step on the device without waiting for `finite`. The running
        # average then moves towards unchanged weights.
        fused = is_fused(self.optimiser)
        if fused:
            skip_step(self.optimiser, ~finite)
        if fused or finite:
            self.scaler.step(self.optimiser)
            if self.running_average is not None:
                self.running_average.update(step)
        self.scaler.update()
        return finite


def network_in_training(
    module: SegmentationNetwork, card: WeightsCard, device: torch.device
) -> Network:
    """Return the network of a module on the device of its training, to validate it.

    It computes in the type of `validation_precision`, whatever the number type of the training.
    """
    return network_of_module(module, card, str(device), validation_precision(device))


def seed_dropout(seed: int, device: torch.device) -> None:
    """Seed the generators that dropout uses on a device.

    ``torch.manual_seed`` also formats the stack of calls, for devices that do not exist here.
    """
    torch.default_generator.manual_seed(seed)
    if device.type == "cuda":
        torch.cuda.manual_seed_all(seed)


def build_optimiser(module: nn.Module, recipe: Recipe, *, fused: bool = False) -> Optimizer:
    """Return the recipe's optimiser of all parameters; a fused one takes a step in one kernel."""
    parameters = list(module.parameters())
    rate = recipe.learning_rate
    decay = recipe.weight_decay
    if recipe.optimiser == "adamw":
        betas = recipe.momentum, 0.999
        return AdamW(parameters, rate, betas, weight_decay=decay, fused=fused)
    optimiser = SGD(parameters, rate, recipe.momentum, weight_decay=decay, fused=fused)
    if fused:
        # A skipped first step would leave them uninitialised.
        for parameter in parameters:
            optimiser.state[parameter]["momentum_buffer"] = torch.zeros_like(parameter)
    return optimiser


def learning_rate(recipe: Recipe, step: int, steps_per_epoch: int) -> float:
    """Return the learning rate of a step, counted from 0 over the whole training."""
    peak = recipe.learning_rate
    warm_up = round(recipe.warm_up * steps_per_epoch)
    if recipe.schedule == "decay":
        if step < warm_up:
            return peak * ((step + 1) / warm_up)
        return peak * float(recipe.decay ** ((step - warm_up) // steps_per_epoch))
    if step < warm_up:
        return peak * _half_cosine(ONE_CYCLE_START, 1, step / warm_up)
    falling = recipe.epochs * steps_per_epoch - 1 - warm_up
    return peak * _half_cosine(1, ONE_CYCLE_END, (step - warm_up) / max(falling, 1))


def _half_cosine(start: float, end: float, progress: float) -> float:
    return end + (start - end) * (1 + math.cos(math.pi * progress)) / 2
