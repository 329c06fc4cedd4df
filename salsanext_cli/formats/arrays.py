# SPDX-License-Identifier: MIT
"""Intermediate results: `.npy` files of a known dtype and shape, never pickled."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.atomic import writing
from salsanext_cli.formats.reading import reading, size_of

HEADER_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


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
        try:
            found_shape, in_columns, found_dtype = _read_header(file)
        except ValueError as error:
            raise FormatError(path, f"not a .npy file ({_first_line(error)})", expected) from error
        if found_dtype != np.dtype(dtype) or not _fits(found_shape, shape):
            raise FormatError(path, f"{found_dtype} {_words(found_shape)}", expected)
        # Compare before allocating: a header can promise any amount of memory.
        promised = math.prod(found_shape) * found_dtype.itemsize
        if (held := size_of(file) - file.tell()) != promised:
            raise FormatError(path, f"{held} bytes of data", f"{promised} bytes", "it is cut off")
        values = np.fromfile(file, found_dtype)
    return values.reshape(found_shape, order="F" if in_columns else "C")


def _read_header(file: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = npy.read_magic(file)
    if version not in HEADER_READERS:
        raise ValueError(f"version {version[0]}.{version[1]}")
    return HEADER_READERS[version](file)


def _fits(found: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(found) == len(wanted) and all(
        length >= 0 and want in (None, length) for length, want in zip(found, wanted, strict=True)
    )


def _words(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if length is None else str(length) for length in shape)})"


def _first_line(error: ValueError) -> str:
    return str(error).splitlines()[0] if str(error) else "unreadable header"


def write_array(path: Path, array: npt.NDArray[Any]) -> None:
    """Write an array as a `.npy` file."""
    array = np.ascontiguousarray(array)
    with writing(path) as file:
        npy.write_array_header_1_0(file, npy.header_data_from_array_1_0(array))
        file.write(array.tobytes())
