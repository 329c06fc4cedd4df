# SPDX-License-Identifier: MIT
"""Checkpoints of the published implementation, read without running anything they contain."""

import io
import re
import struct
import warnings
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZIP_STORED, BadZipFile, ZipFile

import torch
from torch import Tensor
from torch.serialization import MAGIC_NUMBER, PROTOCOL_VERSION

from salsanext_cli.errors import WeightsError, error_text, shortened
from salsanext_cli.files.reading import reason
from salsanext_cli.network.restricted_unpickler import Opaque, RestrictedUnpickler

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
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError),
    *(RuntimeError, TypeError, ValueError, struct.error, BadZipFile),
)
"""Errors over bytes that `torch.save` did not write."""


def read_published(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a published checkpoint under the names that our SalsaNext gives them.

    Accepts what ``torch.save`` wrote: a dictionary with ``state_dict``, or the state dictionary
    itself, its keys with or without the prefix ``module.``.
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
    """Return our name of a tensor: ``up1.stack.fuse.2.bias`` for ``upBlock1.bn4.bias``."""
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


def read_torch_file(path: Path) -> Any:
    """Return what was given to `torch.save`, as `RestrictedUnpickler` builds it, on the CPU.

    Both forms are read: the archive, and that of before torch 1.6. No more memory is taken than a
    few times the size of the file.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise WeightsError(path, "neither a file nor a link to one", "a file of torch.save")
        # In memory: of a file, as many bytes are made room for as a string claims to have.
        content = path.read_bytes()
        read = _read_archive if content.startswith(b"PK\x03\x04") else _read_legacy
        with warnings.catch_warnings():
            # Of escapes in damaged names.
            warnings.simplefilter("ignore")
            return read(io.BytesIO(content))
    except OSError as error:
        raise WeightsError(path, f"cannot be read: {reason(error)}") from error
    except UNREADABLE as error:
        found = f"not readable safely: {error_text(error)}"
        raise WeightsError(path, found, "a file of torch.save") from error


def _require_stored(archive: ZipFile, file: BinaryIO) -> None:
    """Raise `BadZipFile` if an archive holds less than it unpacks to; torch never compresses."""
    members, size = archive.infolist(), file.seek(0, 2)
    compressed = any(member.compress_type != ZIP_STORED for member in members)
    if compressed or sum(member.file_size for member in members) > size:
        raise BadZipFile("it would unpack to more than it holds")


def _read_archive(file: BinaryIO) -> Any:
    with ZipFile(file) as archive:
        _require_stored(archive, file)
        names = archive.namelist()
        (pickled,) = [name for name in names if name.endswith("/data.pkl")]
        folder = pickled.removesuffix("data.pkl")
        if f"{folder}byteorder" in names:
            _require(archive.read(f"{folder}byteorder") == b"little", "big-endian numbers")

        def load(key: str, dtype: torch.dtype, count: int) -> Tensor:
            return _numbers(archive.read(f"{folder}data/{key}"), dtype, count)

        return RestrictedUnpickler(io.BytesIO(archive.read(pickled)), load).load()


def _read_legacy(file: BinaryIO) -> Any:
    """Read four pickles, magic number, version, system and object, then keys and raw numbers."""
    room = file.seek(0, 2)
    file.seek(0)

    def load(key: str, dtype: torch.dtype, count: int) -> Tensor:
        nonlocal room
        room -= count * dtype.itemsize
        _require(count >= 0 and room >= 0, "more numbers than bytes")
        return torch.empty(count, dtype=dtype)

    magic, version, _ = (RestrictedUnpickler(file, load).load() for _ in range(3))
    _require(magic == MAGIC_NUMBER, "neither an archive nor the magic number")
    _require(version == PROTOCOL_VERSION, "an unknown version of the format")
    unpickler = RestrictedUnpickler(file, load)
    found, keys = unpickler.load(), RestrictedUnpickler(file, load).load()
    _require(isinstance(keys, list) and all(type(key) is str for key in keys), "no list of keys")
    _require(sorted(keys) == sorted(unpickler.storages), "keys of other tensors")
    for storage in (unpickler.storages[key] for key in keys):
        (count,) = struct.unpack("<q", file.read(8))
        _require(count == len(storage), f"{count} numbers in place of {len(storage)}")
        storage.copy_(_numbers(file.read(storage.nbytes), storage.dtype, count))
    return found


def _numbers(data: bytes, dtype: torch.dtype, count: int) -> Tensor:
    _require(len(data) == count * dtype.itemsize, f"{len(data)} bytes for {count} numbers")
    return torch.frombuffer(bytearray(data), dtype=dtype) if data else torch.empty(0, dtype=dtype)


def _require(holds: bool, found: str) -> None:
    if not holds:
        raise ValueError(found)
