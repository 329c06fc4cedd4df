# SPDX-License-Identifier: MIT
"""Scans in numpy's files: `.npy` tables, plain or with named fields, and `.npz` archives."""

import io
import math
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, shortened
from salsanext_cli.files.reading import reading
from salsanext_cli.formats.columns import Columns, scan_of, unnamed_columns
from salsanext_cli.formats.npy import read_header
from salsanext_cli.records import Scan

EXPECTED = "a table (N, columns), or columns x, y, z, of numbers"
TABLE_NAMES = ("points", "xyz")
"""Names of the table in an archive of several."""
USUAL_WIDTHS = range(3, 17)
"""Lengths of the last axis of an array of points."""
MAX_RATIO = 100
"""Largest size of an archive's content, as a multiple of its own."""
ARCHIVE_ERRORS = (
    *(zipfile.BadZipFile, zlib.error, EOFError, KeyError, NotImplementedError, OSError),
    *(OverflowError, RuntimeError, ValueError),
)
"""Errors of zipfile for a damaged or encrypted archive, or an unusual compression."""


def read_npy(path: Path, *, columns: tuple[str, ...] = (), intensity_scale: float = 1.0) -> Scan:
    """Read a scan from a `.npy` file: (N, C) numbers, or (N,) records with named fields.

    `path`: the file; `columns`: names of the columns where the file has none; empty for the usual
    ones; `intensity_scale`: divides the intensity.
    """
    with reading(path) as file:
        array = _array(file.read(), path)
    return scan_of(_columns(array, columns, path), path, intensity_scale)


def read_npz(path: Path, *, columns: tuple[str, ...] = (), intensity_scale: float = 1.0) -> Scan:
    """Read a scan from a `.npz` file: columns x, y, z …, or a table and further columns.

    Parameters and errors are those of `read_npy`.
    """
    with reading(path) as file:
        content = file.read()
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_RATIO * len(content):
                raise ValueError("an archive that promises more than it can hold")
            members = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    except ARCHIVE_ERRORS as error:
        raise FormatError(path, "not a whole .npz file", EXPECTED) from error
    arrays = {name: _array(member, path) for name, member in members.items()}
    single = {name: values.ravel() for name, values in arrays.items() if _is_column(values)}
    if not {"x", "y", "z"} <= {name.lower() for name in single}:
        single |= _columns(_table(arrays, path), columns, path)
    counts = sorted({len(values) for values in single.values()})
    if len(counts) > 1:
        found = f"columns of {counts[0]} and of {counts[-1]} points"
        raise FormatError(path, found, "one length")
    return scan_of(single, path, intensity_scale)


def _is_column(values: npt.NDArray[Any]) -> bool:
    """Say whether an array holds one number per point: (N,) or (N, 1)."""
    plain = values.dtype.names is None and values.dtype.kind in "iuf"
    return plain and (values.ndim == 1 or (values.ndim == 2 and values.shape[1] == 1))


def _table(arrays: Mapping[str, npt.NDArray[Any]], path: Path) -> npt.NDArray[Any]:
    """Return the table of an archive: its only one, else the one of the usual name."""
    tables = {
        name: values
        for name, values in arrays.items()
        if values.dtype.names or (values.ndim == 2 and not _is_column(values))
    }
    if len(tables) > 1:
        tables = {name: values for name, values in tables.items() if name in TABLE_NAMES}
    if len(tables) != 1:
        found = shortened(", ".join(arrays)) or "nothing"
        expected = "columns x, y, z, or one table of points, or one of the name points"
        raise FormatError(path, f"arrays {found}", expected)
    return next(iter(tables.values()))


def _columns(table: npt.NDArray[Any], names: tuple[str, ...], path: Path) -> Columns:
    """Return the columns of a table by name."""
    if table.dtype.names and table.ndim == 1:
        return {name: table[name] for name in table.dtype.names if table[name].ndim == 1}
    if table.ndim != 2 or table.dtype.kind not in "iuf":
        raise FormatError(path, *_wrong_table(table))
    return unnamed_columns(table, names, path)


def _wrong_table(table: npt.NDArray[Any]) -> tuple[str, str, str]:
    """Say what an array holds that is no table, what is expected, and how it becomes one."""
    remedy, sizes = "", "×".join(map(str, table.shape))
    if table.dtype.names:
        remedy = "save array.ravel()"
    elif table.dtype.kind in "iuf" and table.ndim > 2 and table.shape[-1] in USUAL_WIDTHS:
        remedy = f"save array.reshape(-1, {table.shape[-1]})"
    kind = shortened(str(table.dtype))
    return f"{sizes} values of {kind}" if sizes else f"a single {kind}", EXPECTED, remedy


def _array(content: bytes, path: Path) -> npt.NDArray[Any]:
    """Read the array of a `.npy` file of any dtype but objects."""
    with io.BytesIO(content) as file:
        shape, in_columns, dtype = read_header(file, path, EXPECTED)
        start = file.tell()
    if dtype.hasobject or not dtype.itemsize:
        raise FormatError(path, f"a .npy file of {shortened(str(dtype))}", EXPECTED)
    # Compare before allocating: a header can promise any amount of memory.
    promised = math.prod(shape) * dtype.itemsize
    if (held := len(content) - start) != promised:
        raise FormatError(path, f"{held} bytes of data", f"{promised} bytes", "it is cut off")
    try:
        values = np.frombuffer(content, dtype, math.prod(shape), start)
        return values.reshape(shape, order="F" if in_columns else "C")
    except ValueError as error:
        # If one length is 0, the others may be any number.
        raise FormatError(path, "a .npy file of an impossible shape", EXPECTED) from error
