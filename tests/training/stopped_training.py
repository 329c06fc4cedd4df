# SPDX-License-Identifier: MIT
"""A training of workers that torchrun starts, which may stop at a step as if it were killed.

::

    torchrun --nproc-per-node 2 stopped_training.py DATASET RUN [STEP]
"""

import os
import sys
from pathlib import Path

import torch
from scans import SMALL
from tiny_network import TinyNetwork

from salsanext_cli.errors import TrainingError
from salsanext_cli.network.registry import ARCHITECTURES
from salsanext_cli.stages.train import train
from salsanext_cli.training import fit
from salsanext_cli.training.distributed import group_of_environment
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe

RECIPE = Recipe(
    epochs=2, batch=2, samples_per_epoch=8, crop_width=32, average=0.5, accumulate=1, dropout=0.5
)
SEVERED = "severed"
"""In place of a step: the second worker looks into a folder of its own."""


def main(dataset: str, run: str, stop: str = "") -> None:
    """Train, with a checkpoint after every step."""
    ARCHITECTURES["salsanext"] = TinyNetwork
    fit.SAVE_INTERVAL_S = 0.0
    original = Learner.step

    def step(self: Learner, images: torch.Tensor, truth: torch.Tensor, at: int, of: int) -> float:
        if str(at) == stop:
            os._exit(3)
        return original(self, images, truth, at, of)

    Learner.step = step  # type: ignore[method-assign]
    apart = stop == SEVERED and not group_of_environment().is_main
    folder = Path(run) / SEVERED if apart else Path(run)
    try:
        train(Path(dataset), folder, recipe=RECIPE, sensor=SMALL, device="cpu")
    except TrainingError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main(*sys.argv[1:])
