# SPDX-License-Identifier: MIT
"""Checkpoints of the published implementation, read without running anything they contain."""

import re
import struct
import warnings
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Self

import torch
from torch import Tensor

from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.texts import shortened
from salsanext_cli.io.files.reading import reason

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
UNREADABLE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RecursionError,
    RuntimeError,
    TypeError,
    ValueError,
    UnpicklingError,
    struct.error,
)
"""Errors of `torch.load` in files of other programs."""
MAX_IGNORED = 64  # Largest number of classes and functions that a checkpoint may name
BUILTINS = ("builtins", "__builtin__")
UNKNOWN_NAME = re.compile(r"GLOBAL ([\w.]+)")


class Ignored:
    """Stand-in for any class or function that a checkpoint names, such as a scheduler."""

    def __new__(cls, *_: object, **__: object) -> Self:
        """Accept and ignore any arguments."""
        return super().__new__(cls)

    def __init__(self, *_: object, **__: object) -> None: ...

    def __setstate__(self, state: object) -> None: ...


STAND_INS: dict[str, object] = {"collections.defaultdict": lambda *_: {}}
"""Stand-ins that torch fills with items, such as the state of an optimiser."""


def read_published(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a published checkpoint, under the names in our SalsaNext."""
    checkpoint = _read_torch_file(path)
    state = checkpoint.get("state_dict", checkpoint) if isinstance(checkpoint, dict) else None
    if not isinstance(state, dict) or not any(isinstance(t, Tensor) for t in state.values()):
        raise WeightsError(path, "has no state_dict of tensors", "a checkpoint of SalsaNext")
    for key, value in state.items():
        if not _is_plain(value):
            problem = f"{shortened(key)} is a {type(value).__name__}"
            raise WeightsError(path, problem, "a dense tensor of real numbers")
    return {our_name(str(key).removeprefix("module."), path): t for key, t in state.items()}


def our_name(key: str, source: object = "checkpoint") -> str:
    """Return our name of a tensor: ``up1.stack.fuse.2.bias`` for ``upBlock1.bn4.bias``."""
    if key in ("logits.weight", "logits.bias"):
        return key
    for pattern, block, units in STACKS:
        match = pattern.fullmatch(key)
        if match and match[2] in units:
            number = int(match[1] or 1)
            name = block.format(number=number, index=number - 1)
            return f"{name}.{units[match[2]]}.{match[3]}"
    expected = "the tensors of the published SalsaNext"
    raise WeightsError(source, f"has the unknown tensor {shortened(key)}", expected)


def _read_torch_file(path: Path) -> Any:
    """Return the content of a file of `torch.save`; `Ignored` replaces unsafe classes."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise WeightsError(path, "is not a regular file", "a file of torch.save")
    try:
        # From a file, torch would reserve the number of bytes that a damaged header states.
        content = path.read_bytes()
    except OSError as error:
        raise WeightsError(path, f"cannot be read: {reason(error)}") from error
    ignored: list[str] = []
    while True:
        stand_ins = [(STAND_INS.get(name, Ignored), name) for name in ignored]
        try:
            with warnings.catch_warnings(), torch.serialization.safe_globals(stand_ins):  # type: ignore[arg-type]
                warnings.simplefilter("ignore")
                return torch.load(  # noqa: TID251
                    BytesIO(content), map_location="cpu", weights_only=True
                )
        except UNREADABLE as error:
            unknown = UNKNOWN_NAME.search(str(error))
            name = unknown[1] if unknown else ""
            names = [name] if "." in name else [f"{module}.{name}" for module in BUILTINS]
            if not name or names[0] in ignored or len(ignored) > MAX_IGNORED:
                # Torch's text advises to run the code in the file.
                problem = f"cannot be read safely, it uses {name}" if name else "has another format"
                raise WeightsError(path, problem, "a file of torch.save") from error
            ignored += names


def _is_plain(value: object) -> bool:
    """Return whether a value is a dense tensor of real numbers in memory."""
    return (
        isinstance(value, Tensor)
        and value.layout is torch.strided
        and value.device.type == "cpu"
        and not (value.is_quantized or value.is_complex())
    )
