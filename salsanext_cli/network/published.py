# SPDX-License-Identifier: MIT
"""Checkpoints of the published implementation, read without running anything they contain."""

from __future__ import annotations

import re
from pathlib import Path

from torch import Tensor

from salsanext_cli.errors import WeightsError
from salsanext_cli.network.restricted_unpickler import Opaque
from salsanext_cli.network.torch_files import read_torch_file
from salsanext_cli.settings_files import shortened

UNITS = {"conv2": "narrow.0", "bn1": "narrow.2", "conv3": "middle.0", "bn2": "middle.2"}
UNITS |= {"conv4": "wide.0", "bn3": "wide.2", "conv5": "fuse.0", "bn4": "fuse.2"}
UP_UNITS = {"conv1": "narrow.0", "bn1": "narrow.2", "conv2": "middle.0", "bn2": "middle.2"}
UP_UNITS |= {"conv3": "wide.0", "bn3": "wide.2", "conv4": "fuse.0", "bn4": "fuse.2"}
CONTEXT_UNITS = {"conv1": "shortcut.0", "conv2": "local.0", "bn1": "local.2"}
CONTEXT_UNITS |= {"conv3": "dilated.0", "bn2": "dilated.2"}
RESIDUAL_UNITS = {"conv1": "shortcut.0"} | {key: f"stack.{name}" for key, name in UNITS.items()}
STACKS = (
    (re.compile(r"downCntx(\d?)\.(\w+)\.(\w+)"), "context.{index}", CONTEXT_UNITS),
    (re.compile(r"resBlock(\d)\.(\w+)\.(\w+)"), "block{number}", RESIDUAL_UNITS),
    (re.compile(r"upBlock(\d)\.(\w+)\.(\w+)"), "up{number}.stack", UP_UNITS),
)


def read_published(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a published checkpoint under the names that our SalsaNext gives them.

    Accepts what ``torch.save`` wrote: a dictionary with ``state_dict``, or the state dictionary
    itself, its keys with or without the prefix ``module.``.

    Raises
    ------
    WeightsError
        If the file is not such a checkpoint.
    """
    checkpoint = read_torch_file(path)
    state = checkpoint.get("state_dict", checkpoint) if isinstance(checkpoint, dict) else None
    if not isinstance(state, dict) or not any(isinstance(t, Tensor) for t in state.values()):
        raise WeightsError(path, "no state_dict of tensors inside", "a checkpoint of SalsaNext")
    for key, value in state.items():
        if not isinstance(value, Tensor):
            kind = value.name if isinstance(value, Opaque) else type(value).__name__
            found = f"{shortened(key)} is no plain tensor but {shortened(kind)}"
            raise WeightsError(path, found, "dense tensors of real numbers")
    return {our_name(str(key).removeprefix("module."), path): t for key, t in state.items()}


def our_name(key: str, source: object = "checkpoint") -> str:
    """Return our name of a published tensor, ``up1.stack.fuse.2.bias`` for ``upBlock1.bn4.bias``.

    Raises
    ------
    WeightsError
        If no published SalsaNext has such a tensor.
    """
    if key in ("logits.weight", "logits.bias"):
        return key
    for pattern, block, units in STACKS:
        match = pattern.fullmatch(key)
        if match and match[2] in units:
            number = int(match[1] or 1)
            place = block.format(number=number, index=number - 1)
            return f"{place}.{units[match[2]]}.{match[3]}"
    raise WeightsError(
        source, f"unknown tensor {shortened(key)}", "the names of the published SalsaNext"
    )
