# SPDX-License-Identifier: MIT
"""Feather files, such as the scans of Argoverse 2, through pyarrow, which is imported when used."""

import io
import logging
from pathlib import Path
from typing import Any

from salsanext_cli.errors import MissingDependency, notice_once
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.files.reading import reading, refusing_damage
from salsanext_cli.formats.columns import Columns
from salsanext_cli.records import Indices

log = logging.getLogger(__name__)


def feather_columns(path: Path) -> Columns:
    """Read the columns of a Feather file."""
    table = read_table(path)
    pairs = zip(table.column_names, table.columns, strict=True)
    columns = {name: values.to_numpy() for name, values in pairs}
    if any(columns[axis].dtype == "f2" for axis in "xyz" if axis in columns):
        notice_once(log, "coordinates of 16 bits, as of Argoverse 2, are rounded: 3 cm at 100 m")
    return columns


def read_table(path: Path) -> Any:
    """Read the table of a Feather file, of version 2, as pyarrow does."""
    with reading(path) as file, refusing_damage(path, "a whole .feather file"):
        try:
            arrow = import_extra("pyarrow", "argoverse")
            ipc = import_extra("pyarrow.ipc", "argoverse")
        except MissingDependency as error:
            found = f"a .feather file needs {error.subject}"
            raise MissingDependency(path, found, remedy=error.remedy) from error
        table = ipc.open_file(arrow.BufferReader(file.read())).read_all()
        table.validate(full=True)
    return table


def feather_subset(table: Any, rows: Indices) -> bytes:
    """Return a Feather file of some rows (M,) of a table."""
    import pyarrow

    with io.BytesIO() as buffer:
        options = pyarrow.ipc.IpcWriteOptions(compression="lz4")
        with pyarrow.ipc.new_file(buffer, table.schema, options=options) as writer:
            writer.write_table(table.take(rows))
        return buffer.getvalue()
