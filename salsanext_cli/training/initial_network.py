# SPDX-License-Identifier: MIT
"""Network that a training starts from: random weights, or those of a file."""

from pathlib import Path
from typing import Any

import torch

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import WeightsError, first_few
from salsanext_cli.network.registry import build
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.network.weights import read_weights
from salsanext_cli.sensors import Sensor, sensor
from salsanext_cli.training.recipe import Recipe

DEFAULT_SENSOR = "hdl64"
"""Sensor of a training from random weights, unless another is given."""


def initial_network(
    weights: Path | None, space: LabelSpace, recipe: Recipe
) -> tuple[SegmentationNetwork, dict[str, Any], Sensor]:
    """Return the network before training, its architecture and its sensor."""
    architecture = {
        "name": recipe.architecture,
        "class_count": space.class_count,
        "dropout": recipe.dropout,
    }
    with torch.random.fork_rng([]):
        torch.manual_seed(recipe.seed)
        module = build(architecture, "recipe key architecture")
    if weights is None:
        return module, architecture, sensor(DEFAULT_SENSOR)
    trained, card = read_weights(weights)
    if not card.space.fits(space):
        differences = first_few(card.space.differences(space))
        found = f"trained for the classes of {card.space.name} ({differences})"
        raise WeightsError(weights, found, f"those of {space.name}")
    if _shapes(trained) != _shapes(module):
        name = card.architecture["name"]
        remedy = f'set architecture = "{name}" in the recipe'
        raise WeightsError(weights, f"of a {name}", f"of a {recipe.architecture}", remedy)
    module.load_state_dict(trained.state_dict())
    return module, architecture, card.sensor


def _shapes(module: SegmentationNetwork) -> dict[str, torch.Size]:
    return {name: tensor.shape for name, tensor in module.state_dict().items()}
