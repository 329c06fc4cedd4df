# SPDX-License-Identifier: MIT
"""Weights files: tensors of a network, and the card that describes them."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.registry import build
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.texts import error_text, first_few, shortened
from salsanext_cli.io.files.atomic import write_target
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.tensor_digest import require_intact, tensor_digest

NORM_SUFFIXES = (".running_mean", ".running_var")


def save_weights(
    path: Path, module: nn.Module, card: WeightsCard, *, half: bool = False, overwrite: bool = True
) -> None:
    """Write a weights file.

    Parameters
    ----------
    path : Path
        Name of the new file.
    module : Module
        Network with the tensors.
    card : WeightsCard
        Its card.
    half : bool
        Whether to store all tensors but the statistics of batch norm in float16.
    overwrite : bool
        Whether it may replace a file.

    Raises
    ------
    OutputError
        If the file cannot be written, or may not replace another.
    """
    write_target(path, encode_weights(module, card, half=half), overwrite=overwrite)


def encode_weights(module: nn.Module, card: WeightsCard, *, half: bool = False) -> bytes:
    """Return the content of a weights file."""
    tensors = {name: _stored(name, tensor, half) for name, tensor in module.state_dict().items()}
    return _encoded(tensors, card)


def _encoded(tensors: dict[str, Tensor], card: WeightsCard) -> bytes:
    """Return the content of a weights file, with the digest of its tensors in the card."""
    digest = tensor_digest(safetensors.torch.save(tensors))
    return safetensors.torch.save(tensors, replace(card, tensors_sha256=digest).to_metadata())


def save_with_card(
    source: Path, target: Path, card: WeightsCard, *, overwrite: bool = True
) -> None:
    """Write a weights file with another card; the tensors, which are checked, stay bit for bit.

    Parameters
    ----------
    source : Path
        Weights file with the tensors.
    target : Path
        Name of the new file.
    card : WeightsCard
        Its card.
    overwrite : bool
        Whether it may replace a file.

    Raises
    ------
    WeightsError
        If the tensors are damaged.
    OutputError
        If the file cannot be written, or may not replace another.
    """
    tensors = safetensors.torch.load_file(source)
    require_intact(source, read_card(source).tensors_sha256)
    write_target(target, _encoded(tensors, card), overwrite=overwrite)


def changes_in_half(module: nn.Module) -> bool:
    """Return whether `save_weights` with `half` would store other values of a network."""
    return any(
        not torch.equal(tensor, _stored(name, tensor, half=True).to(tensor.dtype))
        for name, tensor in module.state_dict().items()
    )


def _stored(name: str, tensor: Tensor, half: bool) -> Tensor:
    tensor = tensor.detach().cpu().contiguous()
    if not half or not tensor.is_floating_point() or name.endswith(NORM_SUFFIXES):
        return tensor
    halved = tensor.half()
    return halved if halved.isfinite().all() else tensor


def read_weights(path: Path) -> tuple[SegmentationNetwork, WeightsCard]:
    """Return the network of a weights file, float32 on the CPU in evaluation mode, and its card."""
    card = read_card(path)
    count = card.space.class_count
    try:
        # The size is that of the label space: a damaged file may state any number. On "meta"
        # no weights are drawn.
        with torch.device("meta"):
            module = build({**card.architecture, "class_count": count}, path)
    except UsageError as error:
        raise WeightsError(path, error.problem, error.expected, error.hint) from error
    classes = card.architecture.get("class_count")
    if classes != count:
        problem = f"has {shortened(classes)} outputs for the {count} classes of {card.space.name}"
        raise WeightsError(path, problem, "one output per class")
    try:
        tensors = safetensors.torch.load_file(path)
    except (OSError, KeyError, ValueError, safetensors.SafetensorError) as error:
        raise WeightsError(path, f"cannot be read: {error_text(error)}") from error
    load_tensors(module, tensors, path)
    require_intact(path, card.tensors_sha256)
    return module.eval(), card


def load_tensors(module: nn.Module, tensors: Mapping[str, Tensor], source: object) -> None:
    """Put tensors into a network.

    Parameters
    ----------
    module : Module
        Network, whose tensors become float32.
    tensors : mapping of str to Tensor
        Tensors by name.
    source : object
        Origin of the tensors in errors.

    Raises
    ------
    WeightsError
        If a name, a shape or a value is wrong.
    """
    expected = module.state_dict()
    missing = expected.keys() - tensors.keys()
    if missing:
        raise WeightsError(source, f"lacks tensors: {_listed(missing)}")
    unknown = tensors.keys() - expected.keys()
    if unknown:
        raise WeightsError(source, f"has unknown tensors: {_listed(unknown)}")
    checked = {name: _checked(name, t, expected[name], source) for name, t in tensors.items()}
    module.load_state_dict(checked, assign=True)


def _listed(names: Iterable[str]) -> str:
    """Return the first of the names of tensors in a short text."""
    return shortened(first_few(sorted(names)))


def _checked(name: str, tensor: Tensor, expected: Tensor, source: object) -> Tensor:
    """Return a tensor in the expected number type; invalid ones raise `WeightsError`."""
    if tensor.shape != expected.shape:
        problem = f"tensor {name} has shape {tuple(tensor.shape)}"
        raise WeightsError(source, problem, str(tuple(expected.shape)))
    if tensor.is_complex():
        raise WeightsError(source, f"tensor {name} is complex", "float32 or float16")
    converted = tensor.to(expected.dtype)
    if not torch.isfinite(converted).all():
        problem = f"tensor {name} is not finite in {expected.dtype}"
        raise WeightsError(source, problem, hint="copy the file again")
    if name.endswith("running_var") and (converted < 0).any():
        raise WeightsError(source, f"tensor {name} has variances below 0")
    return converted
