# SPDX-License-Identifier: MIT
"""Network that a training starts from: random weights, or those of a file."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, WeightsError, first_few
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.registry import build
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.network.weights import read_weights
from salsanext_cli.sensors.sensor import Sensor, sensor
from salsanext_cli.training.recipe import Recipe

DEFAULT_SENSOR = "hdl64"
"""Sensor of a training from random weights, unless another is given."""

log = logging.getLogger(__name__)


def initial_network(
    weights: Path | None, space: LabelSpace, recipe: Recipe, own: Sensor | None
) -> tuple[SegmentationNetwork, WeightsCard]:
    """Return the network before training, and its card: architecture, classes, sensor, scans.

    Without weights it is random; where they are of other classes, so are the outputs of classes
    without one of the same name. The sensor is `own`, else that of the weights, else the default.
    """
    architecture = {
        "name": recipe.architecture,
        "class_count": space.class_count,
        "dropout": recipe.dropout,
    }
    with torch.random.fork_rng([]):
        torch.manual_seed(recipe.seed)
        module = build(architecture, "recipe key architecture")
    if weights is None:
        return module, WeightsCard(architecture, space, _completed(own, sensor(DEFAULT_SENSOR)))
    trained, card = read_weights(weights)
    tensors = trained.state_dict()
    if _shapes(trained) != _shapes(_shaped(architecture, card.space.class_count)):
        name = card.architecture["name"]
        remedy = f'set architecture = "{name}" in the recipe'
        raise WeightsError(weights, f"of a {name}", f"of a {recipe.architecture}", remedy)
    if not card.space.fits(space):
        tensors |= _outputs(module, tensors, card.space, space, architecture)
    module.load_state_dict(tensors)
    begun = WeightsCard(architecture, space, _completed(own, card.sensor))
    return module, replace(begun, trained_on=card.trained_on)


def _completed(own: Sensor | None, trained: Sensor) -> Sensor:
    """Return a sensor, or else that of trained weights, with what these know of it."""
    if own is None:
        return trained
    quantiles = own.intensity_quantiles or trained.intensity_quantiles
    gaps = trained.row_gaps if own.row_gaps is None else own.row_gaps
    return replace(own, intensity_quantiles=quantiles, row_gaps=gaps)


def _outputs(
    module: SegmentationNetwork,
    trained: Mapping[str, Tensor],
    classes: LabelSpace,
    space: LabelSpace,
    architecture: Mapping[str, Any],
) -> dict[str, Tensor]:
    """Return the tensors of the outputs, (C, …), that begin with those of trained classes."""
    more = _shapes(_shaped(architecture, space.class_count + 1))
    own = module.state_dict().items()
    outputs = {name: tensor.clone() for name, tensor in own if tensor.shape != more[name]}
    places = {name: place for place, name in enumerate(classes.names)}
    kept = [place for place, name in enumerate(space.names) if name in places]
    for name, tensor in outputs.items():
        tensor[kept] = trained[name][[places[space.names[place]] for place in kept]]
    new = [name for name in space.names if name not in places]
    text = f"; at random: {first_few(new)}" if new else ""
    log.log(NOTICE, "weights of %d of %d classes kept%s", len(kept), space.class_count, text)
    return outputs


def _shaped(architecture: Mapping[str, Any], class_count: int) -> SegmentationNetwork:
    """Return a network of shapes without values."""
    with torch.device("meta"):
        return build({**architecture, "class_count": class_count})


def _shapes(module: SegmentationNetwork) -> dict[str, torch.Size]:
    return {name: tensor.shape for name, tensor in module.state_dict().items()}
