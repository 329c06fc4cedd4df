# SPDX-License-Identifier: MIT
"""Weights files: one `.safetensors` whose metadata carries everything needed to use them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from salsanext_cli import __version__
from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.network.registry import build
from salsanext_cli.network.restricted_unpickler import DTYPES
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.sensors import Sensor
from salsanext_cli.settings_files import shortened, words_of
from salsanext_cli.storage.atomic import writing

KEY = "salsanext"
"""The one key of the header: safetensors writes several in an order drawn anew each time."""
FORMAT = "salsanext-2"
TABLES = ("architecture", "label_space", "sensor", "recipe", "scores")
"""Parts of a card that are mappings."""
TEMPERATURES = (1e-3, 1e3)
"""Lowest and highest; beyond, the logits of float32 overflow or all classes become equal."""
NORM_SUFFIXES = (".running_mean", ".running_var")


@dataclass(frozen=True, slots=True, eq=False)
class WeightsCard:
    """Metadata of a weights file.

    Attributes
    ----------
    architecture : dict
        Name and numbers of the network, as `registry.build` takes them.
    space : LabelSpace
        The classes that the logits stand for.
    sensor : Sensor
        The geometry and normalisation that the network was trained with.
    recipe : dict
        The resolved training recipe; empty if unknown.
    scores : dict
        Measurements with these weights, and the data; empty if there are none.
    description : str
        A sentence or two on these weights.
    temperature : float
        Divides the logits before the softmax, so that its values are probabilities;
        1 if none was fitted.
    """

    architecture: Mapping[str, Any]
    space: LabelSpace
    sensor: Sensor
    recipe: Mapping[str, Any] = field(default_factory=dict)
    scores: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    temperature: float = 1.0

    def to_metadata(self) -> dict[str, str]:
        """Return what a safetensors header holds; equal cards give equal text."""
        values = {
            "format": FORMAT,
            "version": __version__,
            "description": self.description,
            "architecture": dict(self.architecture),
            "temperature": self.temperature,
            "sensor": self.sensor.to_dict(),
            "label_space": self.space.to_dict(),
            "recipe": dict(self.recipe),
            "scores": dict(self.scores),
        }
        return {KEY: json.dumps(values)}

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str], source: object) -> WeightsCard:
        """Read what a safetensors header holds; anything amiss raises `WeightsError`."""
        try:
            values = json.loads(metadata.get(KEY, "{}"))
            if not isinstance(values, dict):
                raise TypeError(f"{KEY} is no table")
            if (form := values.get("format")) is None:
                expected = "weights that `train` or `import-weights` wrote"
                raise WeightsError(source, "lacks what salsanext writes", expected)
            if form != FORMAT:
                remedy = "use the version that wrote it"
                raise WeightsError(source, f"format {shortened(form)}", FORMAT, remedy)
            if bad := [key for key in TABLES if not isinstance(values[key], dict)]:
                raise TypeError(f"{bad[0]} is no table")
            return cls(
                architecture=values["architecture"],
                space=LabelSpace.from_dict(values["label_space"], source),
                sensor=Sensor.from_dict(values["sensor"], source),
                recipe=values["recipe"],
                scores=values["scores"],
                description=str(values["description"]),
                temperature=_temperature(values["temperature"]),
            )
        except UsageError as error:
            raise WeightsError(source, f"damaged metadata: {error.found}") from error
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise WeightsError(source, f"damaged metadata: {words_of(error)}") from error


def _temperature(value: Any) -> float:
    lowest, highest = TEMPERATURES
    if type(value) not in (int, float) or not lowest <= value <= highest:
        raise ValueError(
            f"temperature {shortened(value)} is not between {lowest:g} and {highest:g}"
        )
    return float(value)


def save_weights(path: Path, module: nn.Module, card: WeightsCard, *, half: bool = False) -> None:
    """Write a weights file, atomically.

    Parameters
    ----------
    path : Path
        The `.safetensors` file.
    module : nn.Module
        The network that `card.architecture` names.
    card : WeightsCard
        Metadata to write.
    half : bool
        Store in float16, half the size; batch-norm statistics stay float32, as does a tensor with a
        value beyond float16's range.
    """
    tensors = {name: _stored(name, tensor, half) for name, tensor in module.state_dict().items()}
    _write(path, tensors, card)


def save_with_card(
    source: Path, target: Path, card: WeightsCard, replaced: Mapping[str, Tensor] = {}
) -> None:
    """Write a weights file's tensors, bit for bit but for those replaced, with another card."""
    _write(target, {**safetensors.torch.load_file(source), **replaced}, card)


def _write(path: Path, tensors: dict[str, Tensor], card: WeightsCard) -> None:
    with writing(path, durable=True) as file:
        file.write(safetensors.torch.save(tensors, card.to_metadata()))


def _stored(name: str, tensor: Tensor, half: bool) -> Tensor:
    tensor = tensor.detach().cpu().contiguous()
    if not half or not tensor.is_floating_point() or name.endswith(NORM_SUFFIXES):
        return tensor
    halved = tensor.half()
    return halved if halved.isfinite().all() else tensor


def read_card(path: Path) -> WeightsCard:
    """Read only the metadata of a weights file.

    Raises
    ------
    WeightsError
        If the file cannot be read or is not one of ours.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
    except (OSError, safetensors.SafetensorError) as error:
        found = f"cannot be read: {words_of(error)}" if path.exists() else "no such file"
        remedy = "convert a published checkpoint with `salsanext import-weights`"
        if path.is_dir():
            found, remedy = "a folder", "name the file in it"
        raise WeightsError(path, found, "a .safetensors file", remedy) from error
    return WeightsCard.from_metadata(metadata, path)


def read_weights(path: Path) -> tuple[SegmentationNetwork, WeightsCard]:
    """Read a weights file: the network in evaluation mode, float32, on the CPU, and its card.

    Raises
    ------
    WeightsError
        If the file cannot be read, its tensors do not fit its architecture, its architecture
        does not fit its label space, or a value is impossible.
    """
    card = read_card(path)
    count = card.space.class_count
    try:
        # Never of a size that somebody wrote into the file.
        module = build({**card.architecture, "class_count": count}, path)
    except UsageError as error:
        raise WeightsError(path, error.found, error.expected) from error
    if (classes := card.architecture.get("class_count")) != count:
        found = f"{shortened(classes)} outputs for the {count} classes of {card.space.name}"
        raise WeightsError(path, found, "one output per class")
    try:
        tensors = safetensors.torch.load_file(path)
    except (OSError, KeyError, ValueError, safetensors.SafetensorError) as error:
        raise WeightsError(path, f"cannot be read: {words_of(error)}") from error
    load_tensors(module, tensors, path)
    return module.eval(), card


def load_tensors(module: nn.Module, tensors: Mapping[str, Tensor], source: object) -> None:
    """Put tensors into a network, float32; names, shapes and values are checked.

    Raises
    ------
    WeightsError
        Naming `source` and the first tensor that does not fit.
    """
    wanted = module.state_dict()
    if missing := sorted(wanted.keys() - tensors.keys()):
        raise WeightsError(source, f"lacks {len(missing)} tensors, such as {shortened(missing[0])}")
    if surplus := sorted(tensors.keys() - wanted.keys()):
        raise WeightsError(
            source, f"holds {len(surplus)} unknown tensors, such as {shortened(surplus[0])}"
        )
    fitting = {name: _checked(name, t, wanted[name], source) for name, t in tensors.items()}
    module.load_state_dict(fitting)


def _checked(name: str, tensor: Tensor, wanted: Tensor, source: object) -> Tensor:
    """Return a tensor in the number type that is wanted; anything amiss raises `WeightsError`."""
    if tensor.shape != wanted.shape:
        raise WeightsError(source, f"{name} is {tuple(tensor.shape)}", str(tuple(wanted.shape)))
    if tensor.dtype not in DTYPES.values():
        raise WeightsError(source, f"{name} is of {tensor.dtype}", "float32 or float16")
    found = tensor.to(wanted.dtype)
    if not torch.isfinite(found).all():
        raise WeightsError(source, f"{name} holds values that are not finite in {found.dtype}")
    if name.endswith("running_var") and (found < 0).any():
        raise WeightsError(source, f"{name} holds variances below 0")
    return found


def default_weights() -> Path:
    """Return the place of the weights that come with the package."""
    return Path(str(resources.files("salsanext_cli") / "presets/weights/default.safetensors"))
