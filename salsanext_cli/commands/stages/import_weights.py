# SPDX-License-Identifier: MIT
"""Stage `import-weights`: a published checkpoint, or weights of salsanext, as a weights file."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.registry import build
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.atomic import WEIGHTS_SUFFIX, require_target
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.sensors import sensor as named_sensor
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.published import read_published
from salsanext_cli.io.weights.weights import (
    changes_in_half,
    load_tensors,
    read_weights,
    save_weights,
)

DROPOUT = 0.2  # Rate of the published networks

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedWeights:
    """Network with its weights, and their card."""

    module: SegmentationNetwork
    card: WeightsCard


def import_weights(
    source: Path,
    target: Path,
    *,
    space: LabelSpace | None = None,
    sensor: Sensor | None = None,
    dropout: float | None = None,
    description: str = "",
    half: bool = False,
    overwrite: bool = False,
) -> WeightsCard:
    """Write a weights file.

    Parameters
    ----------
    source : Path
        Checkpoint of ``torch.save``, or weights file of salsanext.
    target : Path
        Weights file to write.
    space : LabelSpace, optional
        Classes of a checkpoint; default: SemanticKITTI's.
    sensor : Sensor, optional
        Sensor of the weights; default: the sensor of the source, for a checkpoint the HDL-64.
    dropout : float, optional
        Dropout rate of a checkpoint; default: `DROPOUT`.
    description : str
        Description of the weights.
    half : bool
        Whether to store the tensors in float16.
    overwrite : bool
        Whether to replace an existing target.

    Returns
    -------
    WeightsCard
        Card of the target.

    Raises
    ------
    OutputError
        If the target cannot be written, or may not replace another file.
    UsageError
        If weights of salsanext get an argument for checkpoints.
    WeightsError
        If the source cannot be used.
    """
    require_target(target, overwrite)
    if source.suffix == WEIGHTS_SUFFIX:
        if space is not None:
            raise _argument_not_needed("space", source)
        if dropout is not None:
            raise _argument_not_needed("dropout", source)
        imported = _weights_of_salsanext(source, sensor, description, half=half)
    else:
        rate = DROPOUT if dropout is None else dropout
        imported = _published_weights(source, space or label_space(), sensor, rate, description)
    save_weights(target, imported.module, imported.card, half=half, overwrite=overwrite)
    return read_card(target)


def _without_thresholds(card: WeightsCard) -> WeightsCard:
    """Return a card without thresholds of risk, whose guarantee does not cover other labels."""
    if any(parts.risk for parts in (card.parts, *card.parts_of_widths.values())):
        text = "the threshold of `tune risk` is removed: it was chosen for other labels"
        log.log(NOTICE, text)
    return card.without_risk(lambda _: True)


def _argument_not_needed(name: str, source: Path) -> UsageError:
    """Return the error of an argument for a checkpoint, given with weights of salsanext."""
    problem = f"the weights file {source} contains this already"
    return UsageError(argument(name), problem, "a published checkpoint", f"omit {argument(name)}")


def _weights_of_salsanext(
    source: Path, sensor: Sensor | None, description: str, *, half: bool
) -> ImportedWeights:
    """Return weights of salsanext with another sensor or description, if one is given."""
    module, card = read_weights(source)
    if sensor is not None or (half and changes_in_half(module)):
        card = _without_thresholds(card)
    if sensor is not None:
        # The widths are those of the old sensor; the parts for its default width stay.
        card = replace(card, sensor=sensor, widths=(), parts_of_widths={})
    card = replace(card, description=description or card.description, version=None)
    return ImportedWeights(module=module, card=card)


def _published_weights(
    source: Path, space: LabelSpace, sensor: Sensor | None, dropout: float, description: str
) -> ImportedWeights:
    """Return the weights of a published checkpoint; refuse one with other classes."""
    tensors = read_published(source)
    outputs = tensors["logits.bias"].numel() if "logits.bias" in tensors else 0
    if outputs != space.class_count:
        expected = f"{space.class_count}, one per class of {space.name}"
        hint = f"give its label space with {argument('space')}"
        problem = f"has {outputs} outputs" if outputs else "has no layer logits with outputs"
        raise WeightsError(source, problem, expected, hint)
    architecture = {"name": "salsanext", "class_count": outputs, "dropout": dropout}
    module = build(architecture, source)
    load_tensors(module, tensors, source)
    described = description or f"Imported from the published checkpoint {source.name}."
    card = WeightsCard(architecture, space, sensor or named_sensor("hdl64"), description=described)
    return ImportedWeights(module=module, card=card)
