# SPDX-License-Identifier: MIT
"""SHA-256 of the tensors of a weights file, which finds a byte that has changed."""

import hashlib
import io
import json
from pathlib import Path
from typing import BinaryIO

from salsanext_cli.core.errors import WeightsError
from salsanext_cli.io.files.reading import identity, reading

LENGTH_BYTES = 8  # Size of the number with which a safetensors file begins: that of its header
METADATA = "__metadata__"  # Key of the header whose value describes no tensor
PIECE_BYTES = 1 << 20
_INTACT: set[tuple[object, ...]] = set()  # Identities of files whose tensors have been checked


def tensor_digest(content: bytes) -> str:
    """Return the digest of the tensors of a safetensors file, as `require_intact` computes it.

    Parameters
    ----------
    content : bytes
        The file.

    Returns
    -------
    str
        SHA-256 of the names, types, shapes and bytes of the tensors, 64 hexadecimal digits. The
        metadata have no influence.
    """
    return _digest(io.BytesIO(content))


def require_intact(path: Path, stored: str) -> None:
    """Check the tensors of a readable weights file against the digest in its metadata.

    A file is checked once as long as its size and its time stay.

    Parameters
    ----------
    path : Path
        Weights file (.safetensors).
    stored : str
        Digest of `tensor_digest`; empty in a file of an early version, which is not checked.

    Raises
    ------
    WeightsError
        If the tensors have another digest.
    """
    checked = identity(path)
    if not stored or checked in _INTACT:
        return
    with reading(path) as file:
        actual = _digest(file)
    if actual != stored:
        problem = f"has damaged tensors: their SHA-256 begins with {actual[:16]}"
        raise WeightsError(path, problem, stored[:16], "copy the file again")
    _INTACT.add(checked)


def _digest(file: BinaryIO) -> str:
    length = int.from_bytes(file.read(LENGTH_BYTES), "little")
    tensors = json.loads(file.read(length))
    tensors.pop(METADATA, None)
    digest = hashlib.sha256(json.dumps(tensors, sort_keys=True).encode())
    for piece in iter(lambda: file.read(PIECE_BYTES), b""):
        digest.update(piece)
    return digest.hexdigest()
