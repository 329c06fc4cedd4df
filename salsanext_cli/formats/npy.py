# SPDX-License-Identifier: MIT
"""Intermediate results: `.npy` files of a known dtype and shape, never pickled."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.reading import read_values, reading, size_of

MAGIC = b"\x93NUMPY\x01\x00"
HEADER = re.compile(
    rb"\{'descr': '([^']*)', 'fortran_order': (True|False), 'shape': \(([\d, ]*)\), \}\s*"
)
"""The one form in which numpy writes it; its own reader evaluates whatever it finds instead."""


LONGEST = 15
"""Digits of a length; more cannot be calculated with."""


def read_array(path: Path, dtype: npt.DTypeLike, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Read an array of known dtype and shape.

    Parameters
    ----------
    path : Path
        The `.npy` file.
    dtype : dtype-like
        What the file must hold.
    shape : tuple of int or None
        What the file must hold; None stands for any length.

    Raises
    ------
    FormatError
        If the file cannot be read, is no `.npy` file, holds something else, or is cut off.
    """
    expected = f"a .npy file of {np.dtype(dtype)} {_words(shape)}"
    with reading(path) as file:
        description, in_columns, found_shape = _read_header(file, path, expected)
        if description != np.dtype(dtype).str or not _fits(found_shape, shape):
            raise FormatError(path, f"{description} {_words(found_shape)}", expected)
        # Compare before allocating: a header can promise any amount of memory.
        promised = math.prod(found_shape) * np.dtype(dtype).itemsize
        if (held := size_of(file) - file.tell()) != promised:
            raise FormatError(path, f"{held} bytes of data", f"{promised} bytes", "it is cut off")
        values = read_values(file, path, dtype, math.prod(found_shape))
    try:
        return values.reshape(found_shape, order="F" if in_columns else "C")
    except ValueError as error:
        # Of nothing, the other lengths may be any.
        raise FormatError(path, "a .npy file of an impossible shape", expected) from error


def _read_header(file: BinaryIO, path: Path, expected: str) -> tuple[str, bool, tuple[int, ...]]:
    """Return numpy's description of the dtype, whether columns come first, and the shape."""
    magic = file.read(len(MAGIC))
    header = HEADER.fullmatch(file.read(int.from_bytes(file.read(2), "little")))
    if magic != MAGIC or header is None:
        raise FormatError(path, "not a .npy file", expected)
    description, in_columns, lengths = header.groups()
    words = [word.strip() for word in lengths.split(b",") if word.strip()]
    if not all(word.isdigit() and len(word) <= LONGEST for word in words):
        raise FormatError(path, "a .npy file of an impossible shape", expected)
    shape = tuple(map(int, words))
    return description.decode("ascii", "replace"), in_columns == b"True", shape


def _fits(found: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(found) == len(wanted) and all(
        want in (None, length) for length, want in zip(found, wanted, strict=True)
    )


def _words(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if length is None else str(length) for length in shape)})"


def encode_array(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a `.npy` file."""
    array = np.ascontiguousarray(array)
    with io.BytesIO() as file:
        npy.write_array(file, array, version=(1, 0), allow_pickle=False)
        return file.getvalue()
