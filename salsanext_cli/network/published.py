# SPDX-License-Identifier: MIT
"""Checkpoints of the published implementation, read without running anything they contain."""

from __future__ import annotations

import io
import lzma
import pickle
import pickletools
import re
import struct
import warnings
import zipfile
import zlib
from _compat_pickle import IMPORT_MAPPING, NAME_MAPPING
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from salsanext_cli.errors import WeightsError
from salsanext_cli.formats.reading import reason
from salsanext_cli.network.archives import require_stored

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
LEGACY_PICKLES = 4
"""Before torch 1.6: magic number, protocol, system, object; then the raw tensors."""
ADVICE = ("Weights only load failed", "Check the documentation of torch.load")
UNREADABLE = (
    pickle.UnpicklingError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
)
"""What readers of pickles and archives raise over bytes that were not written by `torch.save`."""


class Inert:
    """Stands for any class a checkpoint names beside tensors, such as a scheduler; does nothing."""

    def __new__(cls, *_args: object, **_keywords: object) -> Inert:
        """Accept and forget whatever the pickle passes."""
        return super().__new__(cls)

    def __init__(self, *_args: object, **_keywords: object) -> None:
        """Accept and forget whatever the pickle passes."""

    def __setstate__(self, _state: object) -> None:
        """Forget the state."""


def read_published(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a published checkpoint under the names that our SalsaNext gives them.

    Accepts what ``torch.save`` wrote: a dictionary with ``state_dict``, or the state dictionary
    itself, its keys with or without the prefix ``module.``. Only tensors and plain containers are
    built; every other class in the file becomes an inert stand-in.

    Raises
    ------
    WeightsError
        If the file is not such a checkpoint.
    """
    checkpoint = _load_inert(path)
    state = checkpoint.get("state_dict", checkpoint) if isinstance(checkpoint, Mapping) else None
    if not isinstance(state, Mapping) or not all(isinstance(t, Tensor) for t in state.values()):
        raise WeightsError(path, "no state_dict of tensors inside", "a checkpoint of SalsaNext")
    return {our_name(str(key).removeprefix("module."), path): t for key, t in state.items()}


def _load_inert(path: Path) -> Any:
    """Unpickle with torch's restricted reader, unknown classes replaced by `Inert`."""
    try:
        # In memory: of a file, as many bytes are made room for as a string claims to have.
        with io.BytesIO(path.read_bytes()) as file:
            stand_ins = [_stand_in(name) for name in sorted(_named_globals(file))]
            with torch.serialization.safe_globals(stand_ins), warnings.catch_warnings():
                # torch warns of what it then refuses, or of forms that are merely old.
                warnings.simplefilter("ignore")
                return torch.load(file, map_location="cpu", weights_only=True)
    except OSError as error:
        raise WeightsError(path, f"cannot be read: {reason(error)}") from error
    except UNREADABLE as error:
        found = f"not readable safely: {_first_sentence(error)}"
        raise WeightsError(path, found, "what torch.save wrote") from error


def _stand_in(name: str) -> Any:
    """Return what torch takes for a class of that name; it fills only plain dictionaries."""
    return (_plain_dictionary if name == "collections.defaultdict" else Inert), name


def _plain_dictionary(*_: object) -> dict[Any, Any]:
    return {}


def _first_sentence(error: BaseException) -> str:
    """Say what torch's restricted reader stumbled over, without its advice to trust the file."""
    paragraphs = [paragraph.strip() for paragraph in str(error).split("\n\n")]
    telling = [p for p in paragraphs if p and not p.startswith(ADVICE)]
    return (telling or [type(error).__name__])[0].splitlines()[0].split(". ")[0].rstrip(".")


def _named_globals(file: BinaryIO) -> set[str]:
    """List the classes and functions that a checkpoint's pickles name, without running them.

    torch checks its own list of harmless names first, so that a stand-in never hides a tensor.
    """
    if zipfile.is_zipfile(file):
        with zipfile.ZipFile(file) as archive:
            require_stored(archive, file)
            names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
            pickles: list[BinaryIO] = [io.BytesIO(archive.read(name)) for name in names]
    else:
        pickles = [file] * LEGACY_PICKLES
        file.seek(0)
    operations = (operation for stream in pickles for operation in pickletools.genops(stream))
    named = {tuple(str(arg).split(" ", 1)) for code, arg, _ in operations if code.name == "GLOBAL"}
    file.seek(0)
    return {".".join(_today(*name)) for name in named}


def _today(module: str, name: str = "") -> tuple[str, str]:
    """Return Python 3's name of what pickles name as Python 2 did, such as ``__builtin__``."""
    return NAME_MAPPING.get((module, name), (IMPORT_MAPPING.get(module, module), name))


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
    raise WeightsError(source, f"unknown tensor {key}", "the names of the published SalsaNext")
