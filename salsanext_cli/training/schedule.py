# SPDX-License-Identifier: MIT
"""The learning rate as a plain function of the step: nothing to keep, nothing to pickle."""

from __future__ import annotations

import math

from salsanext_cli.training.recipe import Recipe

START, END = 1 / 25, 1 / 250_000
"""Where a one-cycle schedule begins and ends, as shares of its peak."""


def learning_rate(recipe: Recipe, step: int, steps_per_epoch: int) -> float:
    """Return the learning rate of a step, counted from 0 over the whole training.

    ``decay`` rises in a line to the peak over the warm-up and is then multiplied by `decay` at
    every further epoch. ``one-cycle`` rises in half a cosine from 1/25 of the peak over the
    warm-up and falls in half a cosine to 1/250 000 of it at the last step.
    """
    warm_up = round(recipe.warm_up * steps_per_epoch)
    if recipe.schedule == "decay":
        share = _decay(recipe.decay, step, warm_up, steps_per_epoch)
    else:
        share = _one_cycle(step, warm_up, recipe.epochs * steps_per_epoch - 1)
    return recipe.learning_rate * share


def _decay(factor: float, step: int, warm_up: int, steps_per_epoch: int) -> float:
    if step < warm_up:
        return (step + 1) / warm_up
    return float(factor ** ((step - warm_up) // steps_per_epoch))


def _one_cycle(step: int, peak: int, last: int) -> float:
    if step < peak:
        return _half_cosine(START, 1, step / peak)
    return _half_cosine(1, END, (step - peak) / max(last - peak, 1))


def _half_cosine(start: float, end: float, progress: float) -> float:
    return end + (start - end) * (1 + math.cos(math.pi * progress)) / 2
