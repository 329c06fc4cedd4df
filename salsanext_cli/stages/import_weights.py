# SPDX-License-Identifier: MIT
"""Import of a published checkpoint, or of weights of ours, as a weights file."""

from dataclasses import replace
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace, label_space
from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.files.atomic import WEIGHTS_SUFFIX, require_target
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.published import read_published
from salsanext_cli.network.registry import build
from salsanext_cli.network.weights import load_tensors, read_weights, save_weights
from salsanext_cli.sensors.sensor import Sensor, sensor

DROPOUT = 0.2


def import_weights(
    source: Path,
    target: Path,
    *,
    space: LabelSpace | None = None,
    view: Sensor | None = None,
    dropout: float | None = None,
    description: str = "",
    half: bool = False,
    overwrite: bool = False,
) -> WeightsCard:
    """Write a weights file from a checkpoint of ``torch.save``, or again from one of ours.

    A checkpoint is of SemanticKITTI's classes, the HDL-64 and `DROPOUT` unless told otherwise.
    """
    require_target(target, overwrite)
    if source.suffix == WEIGHTS_SUFFIX:
        for option, value in {"--label-space": space, "--dropout": dropout}.items():
            if value is not None:
                found = f"{source} says for itself"
                raise UsageError(option, found, "a published checkpoint", f"leave {option} out")
        module, card = read_weights(source)
        described = description or card.description
        card = replace(card, description=described, sensor=view or card.sensor, version=None)
    else:
        space, tensors = space or label_space(), read_published(source)
        outputs = tensors["logits.bias"].numel() if "logits.bias" in tensors else 0
        if outputs != space.class_count:
            found = f"{outputs} outputs"
            expected = f"{space.class_count}, one per class of {space.name}"
            raise WeightsError(source, found, expected, "give its label space with --label-space")
        rate = DROPOUT if dropout is None else dropout
        architecture = {"name": "salsanext", "class_count": outputs, "dropout": rate}
        module = build(architecture, source)
        load_tensors(module, tensors, source)
        described = description or f"Imported from the published checkpoint {source.name}."
        card = WeightsCard(architecture, space, view or sensor("hdl64"), description=described)
    save_weights(target, module, card, half=half)
    return card
