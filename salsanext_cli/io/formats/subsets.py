# SPDX-License-Identifier: MIT
"""Scan files with some of their points: header, order and values stay as they are."""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.records import Mask
from salsanext_cli.io.files.reading import reading, refusing_damage
from salsanext_cli.io.formats import errors_of_plug_ins, format_of, kitti, npy, pcd, ply
from salsanext_cli.io.formats.columns import other_number
from salsanext_cli.io.formats.tables.text import BYTE_ORDER_MARK
from salsanext_cli.io.formats.tables.text_layout import layout_of, without_comments

NUMBERS = re.compile(rb"(?mi)^(\s*(?:WIDTH|POINTS|element\s+vertex)\s+)\d+")
NUMBER_ALONE = re.compile(rb"(?m)^(\s*)\d+(?=\s*$)")
ROWS_OF_PCD = re.compile(rb"(?mi)^(\s*HEIGHT\s+)\d+")
COMPRESSED_PCD = re.compile(rb"(?mi)^(\s*DATA\s+binary)_compressed")
END_OF_PLY = re.compile(rb"end_header(?:\r\n|\r|\n)")
Subset = Callable[[Mask], bytes]
"""Function from a mask (N,) bool of the remaining points to the content of a file."""


def subsets_of(path: Path, names: tuple[str, ...] = ()) -> Subset:
    """Read a scan file; return the function that encodes some of its points.

    An organised PCD cloud becomes one row, a compressed one binary. `names` are those of the
    columns of files without names.
    """
    form = format_of(path.name)
    if form is None or form.subset is None:
        expected = "another format, such as .ply"
        hint = "write the scans as .bin or .npy first"
        raise FormatError(path, "is of a format that cannot be written", expected, hint)
    with errors_of_plug_ins(path):
        subset = form.subset(path, names)
    return errors_of_plug_ins(path)(subset)


def npy_subset(path: Path, names: tuple[str, ...]) -> Subset:
    """Read a `.npy` table; an organised cloud becomes one row."""
    table = npy.rows_of(npy.load_npy(path, npy.EXPECTED))
    if npy.is_transposed(table, len(names)):
        return lambda mask: _npy_content(masked(table.T, mask, path).T)
    return lambda mask: _npy_content(masked(table, mask, path))


def _npy_content(table: npt.NDArray[Any]) -> bytes:
    """Return the content of a `.npy` file."""
    return _saved(lambda file: np.save(file, table))


def npz_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read an archive; arrays with N rows or columns belong to the points."""
    arrays, compressed = npy.npz_arrays(path)

    def subset(mask: Mask) -> bytes:
        selected = {}
        for name, array in arrays.items():
            if array.shape[:1] == mask.shape:
                selected[name] = array[mask]
            elif array.ndim == 2 and array.shape[1:] == mask.shape:
                selected[name] = array[:, mask]
        if not selected and len(mask):
            raise other_number(0, len(mask), path)
        save: Callable[..., None] = np.savez_compressed if compressed else np.savez
        return _saved(lambda file: save(file, **arrays | selected))

    return subset


def _saved(save: Callable[[io.BytesIO], object]) -> bytes:
    """Return the content that a function saves into a file."""
    with io.BytesIO() as buffer:
        save(buffer)
        return buffer.getvalue()


def bin_subset(path: Path, names: tuple[str, ...]) -> Subset:
    """Read a file of values without a header."""
    table = kitti.read_table(path, names)
    return lambda mask: table.encode(masked(table.values, mask, path))


def pcd_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read a PCD file."""
    with refusing_damage(path, "a complete .pcd file"):
        return _rows_subset(path, _pcd_rows(_content(path), path))


def ply_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read a PLY file."""
    with refusing_damage(path, "a complete .ply file"):
        return _rows_subset(path, _ply_rows(_content(path), path))


def text_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read a text file of one point per line."""
    content = _content(path)
    mark = len(content) - len(content.removeprefix(BYTE_ORDER_MARK))
    with refusing_damage(path, "a complete text file"):
        layout = layout_of(content[mark:])
    start = mark + layout.start
    number = NUMBERS if layout.count is None else NUMBER_ALONE
    rows = _Rows(header=content[:start], body=without_comments(content[start:]), width=0)
    return _rows_subset(path, rows, number)


def _content(path: Path) -> bytes:
    with reading(path) as file:
        return file.read()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rows:
    """Content of a file of one row per point."""

    header: bytes
    body: bytes
    width: int  # Bytes of a row; 0 for lines


def _rows_subset(path: Path, content: _Rows, number: re.Pattern[bytes] = NUMBERS) -> Subset:
    """Return the function for a file of rows; `number` matches its header up to their number."""
    body = content.body
    width = content.width
    if width:
        rows = np.frombuffer(body[: len(body) // width * width], f"V{width}")
    else:
        rows = np.array([line for line in body.splitlines(True) if line.strip()], object)

    def subset(mask: Mask) -> bytes:
        remaining = masked(rows, mask, path)
        points = remaining.tobytes() if width else b"".join(remaining)
        return number.sub(rb"\g<1>%d" % len(remaining), content.header) + points

    return subset


def masked(rows: npt.NDArray[Any], mask: Mask, path: Path) -> npt.NDArray[Any]:
    """Return the rows (N, …) of a mask; refuse a mask of another length."""
    if len(rows) != len(mask):
        raise other_number(len(rows), len(mask), path)
    return rows[mask]


def _pcd_rows(content: bytes, path: Path) -> _Rows:
    """Return the header of a PCD file for one row, and its points."""
    file = io.BytesIO(content)
    header = pcd.read_header(file, path)
    start = file.tell()
    width = header.point_type.itemsize
    head = ROWS_OF_PCD.sub(rb"\g<1>1", content[:start])
    if header.encoding == "ascii":
        return _Rows(header=head, body=content[start:], width=0)
    if header.encoding == "binary":
        end = start + header.point_count * width
        return _Rows(header=head, body=content[start:end], width=width)
    columns = pcd.read_compressed(file, header)
    points = np.zeros(header.point_count, header.point_type)
    for name in header.scalars:
        if name not in columns or columns[name].dtype != header.point_type[name]:
            problem = f"has compressed values of {name}, which open3d converts"
            hint = "rewrite it as binary, for example with pcl_convert_pcd_ascii_binary"
            raise FormatError(path, problem, "binary or ascii", hint)
        points[name] = columns[name]
    head = COMPRESSED_PCD.sub(rb"\1", head)
    return _Rows(header=head, body=points.tobytes(), width=width)


def _ply_rows(content: bytes, path: Path) -> _Rows:
    """Return the header and the vertices of a PLY file."""
    data = ply.read_ply(path, content)
    end = END_OF_PLY.search(content)
    vertices = data["vertex"]
    others = [element.name for element in data if element is not vertices and element.count]
    if others or vertices.data.dtype.hasobject or end is None:
        problem = f"also contains {', '.join(others) or 'lists'}"
        raise FormatError(path, problem, "points only", "save only the points, in CloudCompare")
    head = content[: end.end()]
    body = content[end.end() :]
    if data.text:
        return _Rows(header=head, body=body, width=0)
    width = vertices.data.itemsize
    return _Rows(header=head, body=body[: width * vertices.count], width=width)
