# SPDX-License-Identifier: MIT
"""Scans in NumPy files: `.npy` tables, plain or with named fields, and `.npz` archives."""

import io
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy.typing as npt

from salsanext_cli.errors import FormatError, first_few, notice_once, shortened
from salsanext_cli.files.reading import reading, refusing_damage, size_of
from salsanext_cli.formats.columns import USED_NAMES, Columns, columns_of_width, unnamed_columns
from salsanext_cli.formats.npy import load_array, load_npy

EXPECTED = "a table (N, columns), or columns x, y, z, of numbers"
TABLE_NAMES = ("points", "xyz")  # Names of the table in an archive of several
USUAL_WIDTHS = range(3, 17)  # Lengths of the last axis of an array of points
UNNAMED = re.compile(r"arr_\d+")  # Name that numpy gives to an unnamed array
MAX_RATIO = 100  # Largest size of an archive's content, as a multiple of its own
Arrays = dict[str, npt.NDArray[Any]]


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
            notice_once("integers in arr_3 are ignored; name them with --columns if they are used")
        notice_once(f"arrays without names are read as {', '.join(single)}")
    elif not {"x", "y", "z"} <= {name.lower() for name in single}:
        table = _columns(_table(arrays, path), names, path)
        if not names and [*table] == ["x", "y", "z"]:
            single = _beside_points(single, len(table["x"]))
        single |= table
    counts = sorted({len(values) for name, values in single.items() if name.lower() in USED_NAMES})
    if len(counts) > 1:
        problem = f"has columns of {counts[0]} and of {counts[-1]} points"
        raise FormatError(path, problem, "one length")
    others = [name for name, values in single.items() if counts and len(values) != counts[0]]
    if others:
        notice_once(f"arrays of another length than the points are skipped: {first_few(others)}")
    return {name: values for name, values in single.items() if name not in others}


def _beside_points(single: Arrays, count: int) -> Arrays:
    """Return the columns beside x, y, z; a single unnamed one of floats is the intensity."""
    unnamed = [n for n, values in single.items() if UNNAMED.fullmatch(n) and len(values) == count]
    if unnamed == [*single] and len(unnamed) == 1 and single[unnamed[0]].dtype.kind == "f":
        notice_once("an array without a name beside x, y, z is read as intensity")
        return {"intensity": single[unnamed[0]]}
    if unnamed:
        notice_once(f"arrays without names beside x, y, z are ignored: {first_few(unnamed)}")
    return single


def npz_arrays(path: Path) -> tuple[Arrays, bool]:
    """Return the arrays of a `.npz` file by name, and whether they are compressed."""
    arrays = {}
    with reading(path) as file, refusing_damage(path, EXPECTED), zipfile.ZipFile(file) as archive:
        if sum(member.file_size for member in archive.infolist()) > MAX_RATIO * size_of(file):
            raise ValueError("its header states more data than it can contain")
        for name in archive.namelist():
            content = archive.read(name)
            array = load_array(io.BytesIO(content), len(content), path, EXPECTED)
            arrays[name.removesuffix(".npy")] = array
        return arrays, any(member.compress_type for member in archive.infolist())


def is_transposed(table: npt.NDArray[Any], columns: int = 0) -> bool:
    """Return whether a table is (C, N): rows of 3 or 4, or `columns`, values of many points."""
    rows, width = table.shape if table.ndim == 2 else (0, 0)
    return rows in ((columns,) if columns else (3, 4)) and width >= USUAL_WIDTHS.stop


def _is_column(values: npt.NDArray[Any]) -> bool:
    """Return whether an array has one number per point: (N,) or (N, 1)."""
    return values.dtype.kind in "iuf" and (values.ndim == 1 or values.shape[1:] == (1,))


def _table(arrays: Arrays, path: Path) -> npt.NDArray[Any]:
    """Return the only table of an archive, else the one with a usual name."""
    tables = {
        name: values
        for name, values in arrays.items()
        if values.dtype.names or (values.ndim == 2 and not _is_column(values))
    }
    if len(tables) > 1:
        tables = {name: values for name, values in tables.items() if name in TABLE_NAMES}
    if len(tables) != 1:
        expected = "columns x, y, z, or one table of points, or one named points"
        problem = f"has arrays {shortened(', '.join(arrays))}" if arrays else "is empty"
        raise FormatError(path, problem, expected)
    return next(iter(tables.values()))


def _columns(table: npt.NDArray[Any], names: tuple[str, ...], path: Path) -> Columns:
    """Return the columns of a table by name."""
    if table.dtype.names and table.ndim == 1:
        return {name: table[name] for name in table.dtype.names if table[name].ndim == 1}
    is_plain = table.dtype.kind in "iuf"
    if is_plain and is_transposed(table, len(names)):
        notice_once("tables of shape (columns, N) are transposed to (N, columns)")
        table = table.T
    if is_plain and table.ndim == 2:
        return unnamed_columns(table, names, path)
    hint = ""
    if table.dtype.names:
        hint = "save array.ravel()"
    elif is_plain and table.ndim > 2 and table.shape[-1] in USUAL_WIDTHS:
        hint = f"save array.reshape(-1, {table.shape[-1]})"
    kind = shortened(f"{table.dtype} {table.shape}")
    raise FormatError(path, f"contains {kind}", EXPECTED, hint)
