# SPDX-License-Identifier: MIT
"""NumPy files, never pickled: scans in `.npy` and `.npz` files, probabilities, uncertainties."""

import io
import math
import re
import warnings
import zipfile
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.records import Float, Mask
from salsanext_cli.core.texts import first_few, shortened
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.files.reading import read_values, reading, refusing_damage, size_of
from salsanext_cli.io.formats.columns import Columns, columns_of_width, unnamed_columns
from salsanext_cli.io.formats.field_names import (
    INTENSITY_NAMES,
    FieldName,
    fields_beside,
    has_axes,
    has_bare_axes,
)

MAX_HEADER_BYTES = 1024  # Largest header; that of an array with a few dimensions has 128
ROUNDING = 0.01  # Largest deviation of a sum over the classes from 1; float16 has a tenth of it
EXPECTED = "a table (N, columns), or columns x, y, z, of numbers"
TABLE_NAMES = ("points", "xyz", "pcloud_points")  # Names of the table in an archive of several
USUAL_WIDTHS = range(3, 17)  # Lengths of the last axis of an array of points
UNNAMED = re.compile(r"arr_\d+")  # Name that numpy gives to an unnamed array
MAX_RATIO = 100  # Largest size of an archive's content, as a multiple of its own
Arrays = dict[str, npt.NDArray[Any]]


def load_array(file: BufferedIOBase, size: int, path: Path, expected: str) -> npt.NDArray[Any]:
    """Read the array of a `.npy` file, of any dtype but objects.

    Parameters
    ----------
    file : BufferedIOBase
        The open file.
    size : int
        Its size in bytes.
    path : Path
        Its path, for errors.
    expected : str
        Content that is required, in words.

    Returns
    -------
    ndarray

    Raises
    ------
    FormatError
        If the file is damaged, or contains objects.
    """
    with refusing_damage(path, expected):
        # A header of version 1 has at most 64 kB; those of later versions may state gigabytes.
        version = npy.read_magic(file)
        if version != (1, 0):
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
        stated = math.prod(shape) * dtype.itemsize
        actual = size - file.tell()
        if actual != stated:
            raise FormatError(path, f"has {actual} bytes of data", str(stated), "copy it again")
        values = read_values(file, path, dtype, math.prod(shape))
        return values.reshape(shape, order="F" if in_columns else "C")


def read_array(path: Path, dtype: npt.DTypeLike, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Read a `.npy` file of a required dtype and shape.

    Parameters
    ----------
    path : Path
        The file.
    dtype : dtype
        Required dtype.
    shape : tuple of int or None
        Required lengths; None stands for any.

    Returns
    -------
    ndarray

    Raises
    ------
    FormatError
        If the array has another dtype or shape, or the file is damaged.
    """
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
    """Read the softmax of the points of a scan.

    Parameters
    ----------
    path : Path
        The `.npy` file.
    count : int
        N, the number of points of the scan.
    class_count : int
        C, the number of classes.

    Returns
    -------
    (N, C) float16

    Raises
    ------
    FormatError
        If the file has another shape, or the numbers are no probabilities.
    """
    softmax = read_array(path, np.float16, (count, class_count))
    sums = np.einsum("nc->n", softmax, dtype=np.float32)
    # NaN fails all comparisons.
    sound = (np.abs(sums - 1) < ROUNDING) & ((softmax >= 0) & (softmax <= 1)).all(axis=1)
    expected = "numbers from 0 to 1 that add up to 1"
    hint = f"predict again with {setting('extras', ('probabilities',))}"
    _require_all(sound, path, "impossible probabilities", expected, hint)
    return softmax


def read_uncertainty(path: Path, count: int | None, highest: float = math.inf) -> Float:
    """Read one kind of uncertainty of the points of a scan.

    Parameters
    ----------
    path : Path
        The `.npy` file.
    count : int, optional
        N, the number of points of the scan; None for any.
    highest : float
        Largest possible value.

    Returns
    -------
    (N,) float32
        Values from 0 on; NaN without a pixel.

    Raises
    ------
    FormatError
        If the file has another shape, or a value is impossible.
    """
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


def npy_columns(path: Path, names: tuple[str, ...]) -> Columns:
    """Read a `.npy` file: (N, C) numbers of the names or the usual ones, or (N,) named records."""
    return _columns(load_npy(path, EXPECTED), names, path)


def npz_columns(path: Path, names: tuple[str, ...]) -> Columns:
    """Read a `.npz` file: named or unnamed columns, or a table and further columns."""
    arrays = npz_arrays(path)[0]
    single = {name: values.ravel() for name, values in arrays.items() if _is_column(values)}
    if len(single) == len(arrays) > 1 and all(map(UNNAMED.fullmatch, single)):
        columns = columns_of_width(len(single), names, path)
        single = dict(zip(columns, single.values(), strict=True))
        if not names and len(single) > len("xyz") and single["intensity"].dtype.kind != "f":
            del single["intensity"]
            named = f"name them with {argument('columns')} if they are used"
            notice_once(f"integers in arr_3 are ignored; {named}")
        notice_once(f"arrays without names are read as {', '.join(single)}")
    elif not has_bare_axes(list(single)) and (_tables(arrays) or not has_axes(list(single))):
        table = _columns(_table(arrays, path), names, path)
        if not names and list(table) == ["x", "y", "z"]:
            single = _beside_points(single, len(table["x"]))
        single |= table
    used = {*single} - {*fields_beside(single)} | {*_intensities(single)}
    counts = sorted({len(values) for name, values in single.items() if name in used})
    if len(counts) > 1:
        problem = f"has columns of {counts[0]} and of {counts[-1]} points"
        raise FormatError(path, problem, "one length")
    others = [name for name, values in single.items() if counts and len(values) != counts[0]]
    if others:
        notice_once(f"arrays of another length than the points are skipped: {first_few(others)}")
    return {name: values for name, values in single.items() if name not in others}


def _intensities(columns: Arrays) -> list[str]:
    """Return the names of the columns that are known as intensities."""
    return [name for name in columns if FieldName.parsed(name).plain in INTENSITY_NAMES]


def _beside_points(single: Arrays, count: int) -> Arrays:
    """Return the columns beside x, y, z; a single unnamed one of floats is the intensity."""
    unnamed = [n for n, values in single.items() if UNNAMED.fullmatch(n) and len(values) == count]
    if unnamed == list(single) and len(unnamed) == 1 and single[unnamed[0]].dtype.kind == "f":
        notice_once("an array without a name beside x, y, z is read as intensity")
        return {"intensity": single[unnamed[0]]}
    if unnamed:
        notice_once(f"arrays without names beside x, y, z are ignored: {first_few(unnamed)}")
    return single


def npz_arrays(path: Path) -> tuple[Arrays, bool]:
    """Return the arrays of a `.npz` file by name, and whether they are compressed."""
    arrays = {}
    with reading(path) as file, refusing_damage(path, EXPECTED), zipfile.ZipFile(file) as archive:
        _require_possible_sizes(archive, size_of(file))
        for name in archive.namelist():
            content = archive.read(name)
            array = load_array(io.BytesIO(content), len(content), path, EXPECTED)
            arrays[name.removesuffix(".npy")] = array
        return arrays, any(member.compress_type for member in archive.infolist())


def _require_possible_sizes(archive: zipfile.ZipFile, size: int) -> None:
    """Refuse an archive of `size` bytes that states more data, before `zipfile` allocates them."""
    members = archive.infolist()
    content = sum(member.file_size for member in members)
    packed = sum(member.compress_size for member in members)
    if content > MAX_RATIO * size or packed > size:
        raise ValueError("its header states more data than it can contain")


def is_transposed(table: npt.NDArray[Any], columns: int = 0) -> bool:
    """Return whether a table is (C, N): rows of 3 or 4, or `columns`, values of many points."""
    rows, width = table.shape if table.ndim == 2 else (0, 0)
    return rows in ((columns,) if columns else (3, 4)) and width >= USUAL_WIDTHS.stop


def _is_column(values: npt.NDArray[Any]) -> bool:
    """Return whether an array has one number per point: (N,) or (N, 1)."""
    return values.dtype.kind in "iuf" and (values.ndim == 1 or values.shape[1:] == (1,))


def _tables(arrays: Arrays) -> Arrays:
    """Return the arrays of an archive that can be tables of points."""
    return {
        name: values
        for name, values in arrays.items()
        if values.dtype.names or (values.ndim == 2 and not _is_column(values))
    }


def _table(arrays: Arrays, path: Path) -> npt.NDArray[Any]:
    """Return the only table of an archive, else the one with a usual name."""
    tables = _tables(arrays)
    if len(tables) > 1:
        tables = {name: values for name, values in tables.items() if name in TABLE_NAMES}
    if len(tables) != 1:
        expected = "columns x, y, z, or one table of points, or one named points"
        problem = f"has arrays {shortened(', '.join(arrays))}" if arrays else "is empty"
        raise FormatError(path, problem, expected)
    return next(iter(tables.values()))


def _columns(table: npt.NDArray[Any], names: tuple[str, ...], path: Path) -> Columns:
    """Return the columns of a table by name."""
    table = rows_of(table)
    if table.dtype.names and table.ndim == 1:
        return {name: table[name] for name in table.dtype.names if table[name].ndim == 1}
    is_plain = table.dtype.kind in "iuf"
    if is_plain and is_transposed(table, len(names)):
        notice_once("tables of shape (columns, N) are transposed to (N, columns)")
        table = table.T
    if is_plain and table.ndim == 2:
        return unnamed_columns(table, names, path)
    kind = shortened(f"{table.dtype} {table.shape}")
    raise FormatError(path, f"contains {kind}", EXPECTED)


def rows_of(table: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a table (N, C), or records (N,), of an organised cloud (rows, columns, C), row by row.

    Other arrays stay as they are.
    """
    is_organised = table.ndim > 2 and table.shape[-1] in USUAL_WIDTHS
    rows: npt.NDArray[Any]
    if table.dtype.names and table.ndim > 1:
        rows = table.ravel()
    elif table.dtype.kind in "iuf" and is_organised:
        rows = table.reshape(-1, table.shape[-1])
    else:
        return table
    notice_once("arrays of more than one row of points are read row by row")
    return rows
