# SPDX-License-Identifier: MIT
"""Feather files, such as the scans of Argoverse 2, through pyarrow, which is imported when used."""

from pathlib import Path

from salsanext_cli.errors import FormatError, notice_once
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.files.reading import reading, refusing_damage
from salsanext_cli.formats.columns import Columns


def feather_columns(path: Path, _: tuple[str, ...] = ()) -> Columns:
    """Read the columns of a Feather file of version 2."""
    with reading(path) as file, refusing_damage(path, "a complete .feather file"):
        content = file.read()
        if content.startswith(b"FEA1"):
            hint = "rewrite it with pyarrow.feather.write_feather"
            raise FormatError(path, "has Feather version 1", "Feather version 2", hint)
        ipc = import_extra("pyarrow", "argoverse").ipc
        try:
            table = ipc.open_file(content).read_all()
        except MemoryError as error:  # of a damaged length
            raise ValueError(str(error)) from error
        table.validate(full=True)
        pairs = zip(table.column_names, table.columns, strict=True)
        columns = {name: values.to_numpy() for name, values in pairs}
    if any(columns[axis].dtype == "f2" for axis in "xyz" if axis in columns):
        notice_once("coordinates of 16 bits, as in Argoverse 2, are rounded: 3 cm at 100 m")
    return columns
