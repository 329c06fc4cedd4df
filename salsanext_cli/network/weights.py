# SPDX-License-Identifier: MIT
"""Weights files: tensors of a network beside the card that says how to use them."""

from collections.abc import Mapping
from pathlib import Path

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from salsanext_cli.errors import UsageError, WeightsError, error_text, shortened
from salsanext_cli.files.atomic import write_bytes, writing
from salsanext_cli.network.card import WeightsCard, read_card, require_tensors
from salsanext_cli.network.registry import build
from salsanext_cli.network.segmentation import SegmentationNetwork

DTYPES = (
    *(torch.float32, torch.float64, torch.float16, torch.bfloat16),
    *(torch.int64, torch.int32, torch.int16, torch.int8, torch.uint8, torch.bool),
)
"""Number types of tensors that can be loaded."""
NORM_SUFFIXES = (".running_mean", ".running_var")


def save_weights(path: Path, module: nn.Module, card: WeightsCard, *, half: bool = False) -> None:
    """Write a weights file, atomically; by `half` in float16, but for statistics of batch norm."""
    tensors = {name: _stored(name, tensor, half) for name, tensor in module.state_dict().items()}
    write_bytes(path, safetensors.torch.save(tensors, card.to_metadata()), durable=True)


def save_with_card(
    source: Path, target: Path, card: WeightsCard, *, overwrite: bool = True
) -> None:
    """Write a weights file with another card; the tensors stay bit for bit."""
    tensors = safetensors.torch.load_file(source)
    with writing(target, durable=True, overwrite=overwrite) as file:
        file.write(safetensors.torch.save(tensors, card.to_metadata()))


def _stored(name: str, tensor: Tensor, half: bool) -> Tensor:
    tensor = tensor.detach().cpu().contiguous()
    if not half or not tensor.is_floating_point() or name.endswith(NORM_SUFFIXES):
        return tensor
    halved = tensor.half()
    return halved if halved.isfinite().all() else tensor


def read_weights(path: Path) -> tuple[SegmentationNetwork, WeightsCard]:
    """Read a weights file: the network in evaluation mode, float32, on the CPU, and its card."""
    require_tensors(path)
    card = read_card(path)
    count = card.space.class_count
    try:
        # Never of a size that somebody wrote into the file. On "meta" nothing is drawn.
        with torch.device("meta"):
            module = build({**card.architecture, "class_count": count}, path)
    except UsageError as error:
        raise WeightsError(path, error.problem, error.expected, error.hint) from error
    if (classes := card.architecture.get("class_count")) != count:
        found = f"{shortened(classes)} outputs for the {count} classes of {card.space.name}"
        raise WeightsError(path, found, "one output per class")
    try:
        tensors = safetensors.torch.load_file(path)
    except (OSError, KeyError, ValueError, safetensors.SafetensorError) as error:
        raise WeightsError(path, f"cannot be read: {error_text(error)}") from error
    load_tensors(module, tensors, path)
    return module.eval(), card


def load_tensors(module: nn.Module, tensors: Mapping[str, Tensor], source: object) -> None:
    """Put tensors into a network, float32; names, shapes and values are checked."""
    wanted = module.state_dict()
    if missing := sorted(wanted.keys() - tensors.keys()):
        raise WeightsError(source, f"lacks {len(missing)} tensors, such as {shortened(missing[0])}")
    if surplus := sorted(tensors.keys() - wanted.keys()):
        found = f"holds {len(surplus)} unknown tensors, such as {shortened(surplus[0])}"
        raise WeightsError(source, found)
    fitting = {name: _checked(name, t, wanted[name], source) for name, t in tensors.items()}
    module.load_state_dict(fitting, assign=True)


def _checked(name: str, tensor: Tensor, wanted: Tensor, source: object) -> Tensor:
    """Return a tensor in the number type that is wanted; anything amiss raises `WeightsError`."""
    if tensor.shape != wanted.shape:
        raise WeightsError(source, f"{name} is {tuple(tensor.shape)}", str(tuple(wanted.shape)))
    if tensor.dtype not in DTYPES:
        raise WeightsError(source, f"{name} is of {tensor.dtype}", "float32 or float16")
    converted = tensor.to(wanted.dtype)
    if not torch.isfinite(converted).all():
        raise WeightsError(source, f"{name} holds values that are not finite in {wanted.dtype}")
    if name.endswith("running_var") and (converted < 0).any():
        raise WeightsError(source, f"{name} holds variances below 0")
    return converted
