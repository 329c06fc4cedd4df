# SPDX-License-Identifier: MIT
"""Feather files, such as the scans of Argoverse 2, and Parquet files.

They are read through pyarrow, which is imported when it is used.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.records import Mask
from salsanext_cli.io.files.reading import reading, refusing_damage
from salsanext_cli.io.formats.columns import Columns, other_number

EXTRA = "argoverse"
FEATHER = "a complete .feather file"
MAX_RATIO = 1000  # Largest size of the content of a Parquet file, as a multiple of its own


def feather_columns(path: Path, _: tuple[str, ...] = ()) -> Columns:
    """Read the columns of a Feather file of version 2."""
    table = _feather_table(path)
    with refusing_damage(path, FEATHER):
        return _columns_of(table)


def feather_subset(path: Path, _: tuple[str, ...] = ()) -> Callable[[Mask], bytes]:
    """Read a Feather file; return the function that encodes some of its rows, with its metadata.

    Columns are compressed with LZ4, as pyarrow writes them; a file does not say how its own are.
    """
    table = _feather_table(path)

    def subset(mask: Mask) -> bytes:
        if table.num_rows != len(mask):
            raise other_number(table.num_rows, len(mask), path)
        arrow = import_extra("pyarrow", EXTRA)
        sink = arrow.BufferOutputStream()
        write = import_extra("pyarrow.feather", EXTRA).write_feather
        write(table.filter(arrow.array(mask)), sink)
        return bytes(sink.getvalue())

    return subset


def _feather_table(path: Path) -> Any:
    """Read the table of a Feather file of version 2."""
    with reading(path) as file, refusing_damage(path, FEATHER):
        content = file.read()
        if content.startswith(b"FEA1"):
            hint = "rewrite it with pyarrow.feather.write_feather"
            raise FormatError(path, "has Feather version 1", "Feather version 2", hint)
        ipc = import_extra("pyarrow", EXTRA).ipc
        return _validated(lambda: ipc.open_file(content).read_all())


def parquet_columns(path: Path, _: tuple[str, ...] = ()) -> Columns:
    """Read the columns of a Parquet file."""
    with reading(path) as file, refusing_damage(path, "a complete .parquet file"):
        content = file.read()
        arrow = import_extra("pyarrow", EXTRA)
        import_extra("pyarrow.parquet", EXTRA)
        opened = arrow.parquet.ParquetFile(arrow.BufferReader(content), pre_buffer=False)
        groups = (opened.metadata.row_group(i) for i in range(opened.metadata.num_row_groups))
        if sum(group.total_byte_size for group in groups) > MAX_RATIO * len(content):
            raise ValueError("its header states more data than it can contain")
        # Threads that decode a column outlive an error in another one, and crash.
        return _columns_of(_validated(lambda: opened.read(use_threads=False)))


def _validated(read: Callable[[], Any]) -> Any:
    """Return a table of pyarrow whose columns have the lengths and texts that it states."""
    try:
        table = read()
    except MemoryError as error:  # of a damaged length
        raise ValueError(str(error)) from error
    table.validate(full=True)
    return table


def _columns_of(table: Any) -> Columns:
    """Return the columns of a table of pyarrow."""
    pairs = zip(table.column_names, table.columns, strict=True)
    columns = {name: values.to_numpy() for name, values in pairs}
    if any(columns[axis].dtype == "f2" for axis in "xyz" if axis in columns):
        notice_once("coordinates of 16 bits, as in Argoverse 2, are rounded: 3 cm at 100 m")
    return columns
