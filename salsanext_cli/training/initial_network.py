# SPDX-License-Identifier: MIT
"""Initial network of a training, random or from weights, and what it inherits from them."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.backend import LOGITS
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import INHERITED, WeightsCard
from salsanext_cli.core.network.registry import build, described
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import first_few
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.sensors import sensor
from salsanext_cli.io.weights.card_file import named_weights, read_card
from salsanext_cli.io.weights.weights import read_weights
from salsanext_cli.training.recipe import Recipe

DEFAULT_SENSOR = "hdl64"  # Sensor of a training from random weights, unless another is given

log = logging.getLogger(__name__)


def initial_network(
    weights: Path | None, space: LabelSpace, recipe: Recipe, seen: Sensor | None
) -> tuple[SegmentationNetwork, WeightsCard]:
    """Return the network before training and its card: architecture, classes, sensor, scans.

    It is random without weights; so are the outputs of classes that the weights do not have.

    Parameters
    ----------
    weights : Path, optional
        Initial weights; random ones by default.
    space : LabelSpace
        Classes of the network.
    recipe : Recipe
        Its architecture, and perhaps the width of the images.
    seen : Sensor, optional
        Sensor of the scans, by default that of the weights, else `DEFAULT_SENSOR`.

    Returns
    -------
    tuple of SegmentationNetwork and WeightsCard

    Raises
    ------
    WeightsError
        If the weights have another architecture than the recipe.
    """
    architecture = described(
        recipe.architecture, class_count=space.class_count, dropout=recipe.dropout
    )
    widths = tuple(dict.fromkeys(recipe.image_widths))
    with torch.random.fork_rng([]):
        torch.manual_seed(recipe.seed)  # noqa: TID251
        module = build(architecture, "recipe key architecture")
    if weights is None:
        chosen = _sensor_of_training(seen, sensor(DEFAULT_SENSOR), recipe)
        card = WeightsCard(architecture, space, chosen, widths=widths)
        return module, card
    trained, card = read_weights(weights)
    if _hidden_shapes(trained) != _hidden_shapes(module):
        name = card.architecture["name"]
        hint = f'set architecture = "{name}" in the recipe'
        raise WeightsError(weights, f"is a {name}", f"a {recipe.architecture}", hint)
    tensors = trained.state_dict()
    if not card.space.fits(space):
        tensors |= _outputs(module, tensors, card.space, space)
    module.load_state_dict(tensors)
    chosen = _sensor_of_training(seen, card.sensor, recipe)
    begun = WeightsCard(architecture, space, chosen, trained_on=card.trained_on, widths=widths)
    return module, begun


def inheriting(card: WeightsCard, weights: Path) -> WeightsCard:
    """Return a card with error model and estimated accuracy of the initial weights, marked."""
    initial = read_card(weights)
    name = named_weights(initial, weights)
    error = initial.error
    fits = initial.space.fits(card.space) and (error is None or error.features == FEATURES)
    if error:
        error = replace(error, scores={INHERITED: name, **error.scores})
    accuracy = initial.accuracy
    if accuracy and not accuracy.inherited_from:
        accuracy = replace(accuracy, inherited_from=name)
    heir = replace(card, temperature=initial.temperature, error=error, accuracy=accuracy)
    inherited = heir.inherited()
    if inherited:
        status = "inherited" if fits else "not inherited, since classes or features differ"
        log.log(NOTICE, "%s: %s; fit a model with `salsanext tune error`", status, inherited)
    return heir if inherited and fits else card


def _sensor_of_training(seen: Sensor | None, trained: Sensor, recipe: Recipe) -> Sensor:
    """Return the sensor of a training: its intensity and row gaps are by default the trained ones.

    The first width of the recipe, if it names any, is that of its images.
    """
    chosen = trained if seen is None else seen
    quantiles = chosen.intensity_quantiles or trained.intensity_quantiles
    gaps = trained.row_gaps if chosen.row_gaps is None else chosen.row_gaps
    completed = replace(chosen, intensity_quantiles=quantiles, row_gaps=gaps)
    return completed.resized(width=recipe.image_widths[0] if recipe.image_widths else None)


def _outputs(
    module: SegmentationNetwork,
    trained: Mapping[str, Tensor],
    classes: LabelSpace,
    space: LabelSpace,
) -> dict[str, Tensor]:
    """Return the tensors of the outputs, (C, …), with the trained values of shared classes."""
    outputs = {f"{LOGITS}.{key}": t.clone() for key, t in module.logits.state_dict().items()}
    trained_ids = {name: i for i, name in enumerate(classes.names)}
    shared = [i for i, name in enumerate(space.names) if name in trained_ids]
    reused = [trained_ids[space.names[i]] for i in shared]
    for name, tensor in outputs.items():
        tensor[shared] = trained[name][reused]
    new = [name for name in space.names if name not in trained_ids]
    text = f"; at random: {first_few(new)}" if new else ""
    log.log(NOTICE, "weights of %d of %d classes reused%s", len(shared), space.class_count, text)
    return outputs


def _hidden_shapes(module: SegmentationNetwork) -> dict[str, torch.Size]:
    """Return the shapes of the tensors of all layers except the outputs, by name."""
    tensors = module.state_dict().items()
    return {name: tensor.shape for name, tensor in tensors if not name.startswith(f"{LOGITS}.")}
