# SPDX-License-Identifier: MIT
"""`.npy` files, never pickled, among them those of probabilities and uncertainties."""

import math
import warnings
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salsanext_cli.errors import FormatError, notice_once, shortened
from salsanext_cli.files.reading import read_values, reading, refusing_damage, size_of
from salsanext_cli.records import Float, Mask

MAX_HEADER_BYTES = 1024  # Largest header; that of an array with a few dimensions has 128
ROUNDING = 0.01  # Largest deviation of a sum over the classes from 1; float16 has a tenth of it


def load_array(file: BufferedIOBase, size: int, path: Path, expected: str) -> npt.NDArray[Any]:
    """Read the array, of any dtype but objects, of a `.npy` file of `size` bytes."""
    with refusing_damage(path, expected):
        # A header of version 1 has at most 64 kB; those of later versions may state gigabytes.
        if (version := npy.read_magic(file)) != (1, 0):
            number = ".".join(map(str, version))
            raise FormatError(path, f"has .npy version {number}", f"{expected} of version 1.0")
        with warnings.catch_warnings():
            # Parsing a header as Python may warn before it fails.
            warnings.simplefilter("ignore")
            header = npy.read_array_header_1_0(file, max_header_size=MAX_HEADER_BYTES)
        shape, in_columns, dtype = header
        if dtype.hasobject or not dtype.itemsize:
            raise FormatError(path, f"is a .npy file of {shortened(str(dtype))}", expected)
        # Compare before allocating: a header can state any amount of memory.
        stated, actual = math.prod(shape) * dtype.itemsize, size - file.tell()
        if actual != stated:
            raise FormatError(path, f"has {actual} bytes of data", str(stated), "copy it again")
        values = read_values(file, path, dtype, math.prod(shape))
        return values.reshape(shape, order="F" if in_columns else "C")


def read_array(path: Path, dtype: npt.DTypeLike, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Read a `.npy` file of a required dtype and shape, in which None stands for any length."""
    required = np.dtype(dtype)
    expected = f"a .npy file of {required} {_words(shape)}"
    array = load_npy(path, expected)
    fits = all(want in (None, length) for length, want in zip(array.shape, shape, strict=False))
    if array.dtype != required or array.ndim != len(shape) or not fits:
        raise FormatError(path, f"contains {array.dtype.str} {_words(array.shape)}", expected)
    return array


def read_integers(path: Path) -> npt.NDArray[np.integer[Any]]:
    """Read an array (N,) of integers of any size."""
    expected = "a .npy file of integers (N,)"
    array = load_npy(path, expected)
    if array.ndim == 2 and 1 in array.shape:
        notice_once("labels of shape (N, 1) are read as (N,)")
        array = array.ravel()
    if array.dtype.kind not in "iu" or array.ndim != 1:
        problem = f"contains {array.dtype.str} {_words(array.shape)}"
        raise FormatError(path, problem, expected, "save array.ravel().astype(np.uint32)")
    return array


def load_npy(path: Path, expected: str) -> npt.NDArray[Any]:
    """Read the array of a `.npy` file."""
    with reading(path) as file:
        return load_array(file, size_of(file), path, expected)


def _words(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if length is None else str(length) for length in shape)})"


def read_probabilities(path: Path, count: int, class_count: int) -> npt.NDArray[np.float16]:
    """Read the softmax of the points of a scan, (count, class_count) float16."""
    softmax = read_array(path, np.float16, (count, class_count))
    sums = np.einsum("nc->n", softmax, dtype=np.float32)
    # NaN fails all comparisons.
    sound = (np.abs(sums - 1) < ROUNDING) & ((softmax >= 0) & (softmax <= 1)).all(axis=1)
    expected = "numbers from 0 to 1 that add up to 1"
    hint = "predict again with --probabilities"
    _require_all(sound, path, "impossible probabilities", expected, hint)
    return softmax


def read_uncertainty(path: Path, count: int | None, highest: float = math.inf) -> Float:
    """Read one kind of uncertainty, 0 to `highest`, (count,) float32; NaN without a pixel."""
    values: Float = read_array(path, np.float32, (count,))
    expected = f"finite numbers from 0 to {highest:g}, or NaN for a point without a pixel"
    unsound = (values < 0) | np.isinf(values) | (values > highest)
    hint = "run `salsanext uncertainty` again"
    _require_all(~unsound, path, "impossible uncertainty", expected, hint)
    return values


def _require_all(sound: Mask, path: Path, values: str, expected: str, hint: str) -> None:
    if not sound.all():
        count = len(sound) - int(sound.sum())
        problem = f"has {values} at {count} of {len(sound)} points"
        raise FormatError(path, problem, expected, hint)
