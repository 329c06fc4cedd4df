# SPDX-License-Identifier: MIT
"""Optimiser, learning rate, running average and number type of a recipe."""

from __future__ import annotations

import math

import torch
from torch import nn

from salsanext_cli.training.recipe import Recipe

ONE_CYCLE_START, ONE_CYCLE_END = 1 / 25, 1 / 250_000
"""Learning rate at both ends of a one-cycle schedule, as shares of its peak."""
BFLOAT16_CAPABILITY = 8
"""Lowest compute capability (major) of GPUs that compute in bfloat16: Ampere."""


def build_optimiser(module: nn.Module, recipe: Recipe) -> torch.optim.Optimizer:
    """Return the recipe's optimiser of all parameters."""
    parameters, rate, decay = module.parameters(), recipe.learning_rate, recipe.weight_decay
    if recipe.optimiser == "sgd":
        return torch.optim.SGD(parameters, rate, recipe.momentum, weight_decay=decay)
    return torch.optim.AdamW(parameters, rate, (recipe.momentum, 0.999), weight_decay=decay)


def learning_rate(recipe: Recipe, step: int, steps_per_epoch: int) -> float:
    """Return the learning rate of a step, counted from 0 over the whole training.

    ``decay`` rises linearly to the peak over the warm-up and is then multiplied by `decay` at
    every further epoch. ``one-cycle`` rises in half a cosine from 1/25 of the peak over the
    warm-up and falls in half a cosine to 1/250 000 of it at the last step.
    """
    peak, warm_up = recipe.learning_rate, round(recipe.warm_up * steps_per_epoch)
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


@torch.no_grad()
def update_average(average: nn.Module, module: nn.Module, decay: float, step: int) -> None:
    """Move the running average of the weights towards a module, batch norm's statistics too.

    The first steps move it farther, so that the random weights of the start are soon forgotten.
    """
    decay = min(decay, (1 + step) / (10 + step))
    for kept, new in zip(average.state_dict().values(), module.state_dict().values(), strict=True):
        if kept.is_floating_point():
            kept.lerp_(new, 1 - decay)
        else:
            kept.copy_(new)


def dtype_of(precision: str, device: torch.device) -> torch.dtype:
    """Return the type behind a recipe's `precision` on a device.

    "auto" is float32 on every CPU, so that a training does not depend on which one it is; on GPUs
    it is bfloat16, or float16 on those too old for it.
    """
    if precision != "auto":
        dtype: torch.dtype = getattr(torch, precision)
        return dtype
    if device.type != "cuda":
        return torch.float32
    major, _ = torch.cuda.get_device_capability(device)
    return torch.bfloat16 if major >= BFLOAT16_CAPABILITY else torch.float16
