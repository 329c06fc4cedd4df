# SPDX-License-Identifier: MIT
"""Valid files of points in the formats of other programs, made of named columns."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping

import numpy as np
import pytest

Table = Mapping[str, np.ndarray]


def feather(table: Table) -> list[bytes]:
    """Return files of pyarrow, compressed and not."""
    arrow = pytest.importorskip("pyarrow")
    write = pytest.importorskip("pyarrow.feather").write_feather
    seeds = []
    for compression in ("lz4", "zstd", "uncompressed"):
        stream = io.BytesIO()
        write(arrow.table(dict(table)), stream, compression=compression)
        seeds.append(stream.getvalue())
    return seeds


def parquet(table: Table) -> list[bytes]:
    """Return files of pyarrow, compressed and not."""
    arrow = pytest.importorskip("pyarrow")
    write = pytest.importorskip("pyarrow.parquet").write_table
    seeds = []
    for compression in ("snappy", "zstd", "none"):
        stream = io.BytesIO()
        write(arrow.table(dict(table)), stream, compression=compression)
        seeds.append(stream.getvalue())
    return seeds


def structured(table: Table) -> list[bytes]:
    """Return a table with named fields, and plain ones in both orders."""
    fields = np.zeros(len(table["x"]), [(name, values.dtype) for name, values in table.items()])
    for name, values in table.items():
        fields[name] = values
    plain = np.column_stack([*table.values()])
    return [_saved(np.save, array) for array in (fields, plain, np.asfortranarray(plain[:, :4]))]


def organised(table: Table) -> list[bytes]:
    """Return a table and records in two rows, and the transpose of a table."""
    plain = np.column_stack([*table.values()])[:, :4]
    records = np.rec.fromarrays([*table.values()], names=",".join(table))
    arrays = (plain.reshape(2, -1, 4), records.reshape(2, -1), plain.T)
    return [_saved(np.save, array) for array in arrays]


def npz(table: Table) -> list[bytes]:
    """Return archives of columns, and of a table and a column, compressed and not."""
    points = np.column_stack([table[axis] for axis in "xyz"])
    of_table = {"points": points, "intensity": table["intensity"]}
    return [
        _saved(save, **arrays)
        for save in (np.savez, np.savez_compressed)
        for arrays in (table, of_table)
    ]


def _saved(save: Callable[..., None], *array: np.ndarray, **arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    save(stream, *array, **arrays)
    return stream.getvalue()


def lines(table: Table, mark: str) -> list[bytes]:
    """Return lines of values with a header, with a comment in its place, and without."""
    rows = zip(*(values.tolist() for values in table.values()), strict=True)
    body = "".join(mark.join(map(str, row)) + "\n" for row in rows)
    names = mark.join(table)
    return [head.encode() + body.encode() for head in (f"{names}\n", f"//{names}\n", "")]


def named_lines(table: Table) -> list[bytes]:
    """Return lines with units in their names, as of Ouster, and with empty cells."""
    columns = {"x": "X1 (mm)", "y": "Y1 (mm)", "z": "Z1 (mm)", "intensity": "REFLECTIVITY (%)"}
    names = [columns.get(name, f"{name} [1]") for name in table]
    rows = list(zip(*(values.tolist() for values in table.values()), strict=True))
    body = "".join(", ".join(map(str, row)) + "\n" for row in rows)
    gaps = "".join(f"{x},,{z},{i}, \n,,,,\nNA,null,1,2,3\n" for x, _, z, i, _ in rows)
    return [f"# {', '.join(names)}\n{body}".encode(), f"{','.join(names)}\n{gaps}".encode()]


def leica(table: Table) -> list[bytes]:
    """Return points of Leica, whose first line is their number."""
    xyz = zip(*(table[axis].tolist() for axis in "xyz"), strict=True)
    rows = "".join(f"{x} {y} {z} -119 10 20 30\n" for x, y, z in xyz)
    return [f"{len(table['x'])}\n{rows}".encode()]
