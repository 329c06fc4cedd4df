# SPDX-License-Identifier: MIT
"""`.npy` files of a known dtype and shape, never pickled: the intermediate results.

Probabilities and uncertainties of points are checked for possible values too.
"""

import io
import math
import warnings
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salsanext_cli.errors import FormatError
from salsanext_cli.files.reading import read_values, reading, size_of
from salsanext_cli.records import Float

MAX_HEADER_BYTES = 1024
"""Largest header; that of an array with a few dimensions has 128."""
HEADER_ERRORS = (
    *(ArithmeticError, AttributeError, LookupError, MemoryError, RecursionError, SyntaxError),
    *(TokenError, TypeError, ValueError),
)
"""Errors of numpy for a header that is no Python literal, or not that of an array."""
ROUNDING = 0.01
"""Largest deviation of a sum over the classes from 1; that by float16 is a tenth of it."""


def read_array(path: Path, dtype: npt.DTypeLike, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Read an array of known dtype and shape.

    `path`: the `.npy` file; `dtype`: required dtype; `shape`: required shape; None stands for any
    length.
    """
    required = np.dtype(dtype)
    expected = f"a .npy file of {required} {_words(shape)}"
    with reading(path) as file:
        found_shape, in_columns, found = read_header(file, path, expected)
        lengths = zip(found_shape, shape, strict=False)
        fits = all(want in (None, length) for length, want in lengths)
        if found != required or len(found_shape) != len(shape) or not fits:
            raise FormatError(path, f"{found.str} {_words(found_shape)}", expected)
        # Compare before allocating: a header can promise any amount of memory.
        promised = math.prod(found_shape) * required.itemsize
        if (held := size_of(file) - file.tell()) != promised:
            raise FormatError(path, f"{held} bytes of data", f"{promised} bytes", "it is cut off")
        values = read_values(file, path, required, math.prod(found_shape))
    try:
        return values.reshape(found_shape, order="F" if in_columns else "C")
    except ValueError as error:
        # If one length is 0, the others may be any number.
        raise FormatError(path, "a .npy file of an impossible shape", expected) from error


def read_integers(path: Path) -> npt.NDArray[np.integer[Any]]:
    """Read an array (N,) of integers of any size."""
    expected = "a .npy file of integers (N,)"
    with reading(path) as file:
        shape, _, dtype = read_header(file, path, expected)
    if dtype.kind not in "iu" or len(shape) != 1:
        remedy = "save array.ravel().astype(np.uint32)"
        raise FormatError(path, f"{dtype.str} {_words(shape)}", expected, remedy)
    return read_array(path, dtype, (None,))


def read_header(
    file: BinaryIO, path: Path, expected: str
) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read the header of a `.npy` file.

    `file`: positioned at the start; at the end, at the first value; `path`, `expected`: subject and
    expectation of the error.

    Returns the shape, whether the first index varies fastest, and the dtype.
    """
    try:
        # A header of version 1 has 64 kB at most; those of later versions may promise gigabytes.
        if (version := npy.read_magic(file)) != (1, 0):
            raise ValueError(f"version {version}")
        with warnings.catch_warnings():
            # A header that is parsed as Python may warn before it is refused.
            warnings.simplefilter("ignore")
            return npy.read_array_header_1_0(file, max_header_size=MAX_HEADER_BYTES)
    except HEADER_ERRORS as error:
        raise FormatError(path, "not a .npy file", expected) from error


def _words(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if length is None else str(length) for length in shape)})"


def encode_array(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a `.npy` file."""
    array = np.ascontiguousarray(array)
    with io.BytesIO() as file:
        npy.write_array(file, array, version=(1, 0), allow_pickle=False)
        return file.getvalue()


def read_probabilities(path: Path, count: int, class_count: int) -> npt.NDArray[np.float16]:
    """Read the softmax of a scan's points, (N, C) float16.

    `path`: the `.npy` file; `count`, `class_count`: n and C.
    """
    softmax = read_array(path, np.float16, (count, class_count))
    sums = np.einsum("nc->n", softmax, dtype=np.float32)
    # NaN fails all comparisons.
    sound = (np.abs(sums - 1) < ROUNDING) & ((softmax >= 0) & (softmax <= 1)).all(axis=1)
    expected = "numbers from 0 to 1 that add up to 1"
    remedy = "predict again with --probabilities"
    _require_none(~sound, path, "NaN or no probabilities", expected, remedy)
    return softmax


def read_uncertainty(path: Path, count: int | None, highest: float = math.inf) -> Float:
    """Read one kind of uncertainty of a scan's points, (N,) float32; NaN where there is none.

    `path`: the `.npy` file; `count`: n; None for any number; `highest`: largest possible value: 1
    for a probability.
    """
    values: Float = read_array(path, np.float32, (count,))
    bounded = math.isfinite(highest)
    found = f"below 0 or above {highest:g}" if bounded else "negative or infinite"
    numbers = f"numbers from 0 to {highest:g}" if bounded else "numbers from 0"
    expected = f"{numbers}, or NaN for a point without a pixel"
    remedy = "run `salsanext uncertainty` again"
    unsound = (values < 0) | np.isinf(values) | (values > highest)
    _require_none(unsound, path, found, expected, remedy)
    return values


def _require_none(
    unsound: npt.NDArray[np.bool_], path: Path, found: str, expected: str, remedy: str
) -> None:
    if count := int(unsound.sum()):
        found = f"{found} at {count} of {len(unsound)} points"
        raise FormatError(path, found, expected, remedy)
