# SPDX-License-Identifier: MIT
"""Files of scans with some of their points: their headers, then the points as they are."""

import copy
import gzip
import io
import re
from collections.abc import Callable
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, LabelError, counted
from salsanext_cli.files.reading import reading, refusing_damage
from salsanext_cli.formats import (
    errors_of_plug_ins,
    format_of,
    kitti,
    las,
    numpy_scans,
    pcd,
    ply,
    text,
)
from salsanext_cli.formats.feather import read_table
from salsanext_cli.formats.npy import load_npy
from salsanext_cli.records import Mask

NUMBERS = re.compile(rb"(?m)^(\s*(?:WIDTH|POINTS|element\s+vertex)\s+)\d+")
NUMBER_ALONE = re.compile(rb"(?m)^(\s*)\d+(?=\s*$)")
ROWS_OF_PCD = re.compile(rb"(?m)^(\s*HEIGHT\s+)\d+")
COMPRESSED_PCD = re.compile(rb"(?mi)^(\s*DATA\s+binary)_compressed")
END_OF_PLY = re.compile(rb"end_header(?:\r\n|\r|\n)")
Subset = Callable[[Mask], bytes]
"""Function from the points that stay, (N,) bool, to the content of a file with only these."""


def subsets_of(path: Path, names: tuple[str, ...] = ()) -> Subset:
    """Read a scan file; return a function that gives its content with the points that stay.

    Header, order and values stay; an organised PCD cloud becomes one row, a compressed one binary.
    `names`: of the columns of files that do not name them.
    """
    form = format_of(path.name)
    if form is None or form.subset is None:
        hint = "write masks with --indices"
        raise FormatError(path, "a format that cannot be written", "another format", hint)
    with errors_of_plug_ins(path):
        subset = form.subset(path, names)
    return errors_of_plug_ins(path)(subset)


def las_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read a LAS or LAZ file."""
    header, points = las.read_points(path, further_records=True)
    compressed = header.are_points_compressed

    def subset(keep: Mask) -> bytes:
        _kept(points.array, keep, path)
        laspy = las.import_laspy(path, compressed=compressed)
        backend = laspy.LazBackend.Lazrs if compressed else None
        cloud = laspy.LasData(copy.deepcopy(header), points[keep])
        return _written(cloud.write, do_compress=compressed, laz_backend=backend)

    return subset


def npy_subset(path: Path, names: tuple[str, ...]) -> Subset:
    """Read a `.npy` table."""
    table = load_npy(path, numpy_scans.EXPECTED)
    if numpy_scans.is_transposed(table, len(names)):
        return lambda keep: _written(np.save, _kept(table.T, keep, path).T)
    return lambda keep: _written(np.save, _kept(table, keep, path))


def npz_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read an archive; all its arrays of N rows or columns are of the points."""
    arrays, compressed = numpy_scans.npz_arrays(path)

    def subset(keep: Mask) -> bytes:
        of_points = {n: each[keep] for n, each in arrays.items() if each.shape[:1] == keep.shape}
        of_points |= {
            name: each[:, keep]
            for name, each in arrays.items()
            if each.ndim == 2 and each.shape[1:] == keep.shape != each.shape[:1]
        }
        _kept(keep[: len(keep) * bool(of_points)], keep, path)
        return _written(np.savez_compressed if compressed else np.savez, **arrays | of_points)

    return subset


def feather_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read a Feather file."""
    table = read_table(path)

    def subset(keep: Mask) -> bytes:
        from pyarrow.feather import write_feather

        rows = table.take(_kept(np.arange(len(table)), keep, path))
        return _written(lambda buffer: write_feather(rows, buffer))

    return subset


def _written(write: Callable[..., object], *arguments: Any, **options: Any) -> bytes:
    """Return what a function writes into its first argument, a file."""
    with io.BytesIO() as buffer:
        write(buffer, *arguments, **options)
        return buffer.getvalue()


def bin_subset(path: Path, names: tuple[str, ...]) -> Subset:
    """Read a file of float32 values, which may be compressed by gzip."""
    content, packed = _content(path), path.name.lower().endswith(kitti.GZIP_SUFFIX)
    if packed:
        content = kitti.decompressed(io.BytesIO(content), path)[0].getvalue()
    subset = _rows_subset(path, b"", content, 4 * (len(names) or kitti.usual_width(path)))
    return (lambda keep: gzip.compress(subset(keep))) if packed else subset


def pcd_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read a PCD file."""
    with refusing_damage(path, "a whole .pcd file"):
        return _rows_subset(path, *_pcd_parts(_content(path), path))


def ply_subset(path: Path, _: tuple[str, ...]) -> Subset:
    """Read a PLY file."""
    with refusing_damage(path, "a whole .ply file"):
        return _rows_subset(path, *_ply_parts(_content(path), path))


def text_subset(path: Path, names: tuple[str, ...]) -> Subset:
    """Read a text file of one point per line."""
    content = _content(path)
    mark = len(content) - len(content.removeprefix(text.BYTE_ORDER_MARK))
    with refusing_damage(path, "a whole text file"):
        layout = text.layout_of(content[mark:], has_names=bool(names))
    start = mark + layout.start
    number = NUMBERS if layout.count is None else NUMBER_ALONE
    return _rows_subset(path, content[:start], content[start:], 0, number)


def _content(path: Path) -> bytes:
    with reading(path) as file:
        return file.read()


def _rows_subset(
    path: Path, head: bytes, body: bytes, width: int, number: re.Pattern[bytes] = NUMBERS
) -> Subset:
    """Return the function for points of so many bytes, or lines if 0, after a header.

    `number`: pattern of the header that ends with the number of points.
    """
    lines = [] if width else [line for line in body.splitlines(keepends=True) if line.strip()]
    whole = len(body) // width * width if width else 0
    rows = np.frombuffer(body[:whole], f"V{width}") if width else np.empty(len(lines))

    def subset(keep: Mask) -> bytes:
        kept = _kept(rows, keep, path)
        points = kept.tobytes() if width else b"".join(compress(lines, keep.tolist()))
        return number.sub(rb"\g<1>%d" % len(kept), head) + points

    return subset


def _kept(rows: npt.NDArray[Any], keep: Mask, path: Path) -> npt.NDArray[Any]:
    if len(rows) != len(keep):
        expected = f"{len(keep):,}, as it has labels"
        raise LabelError(path, counted(len(rows), "point"), expected, "predict again")
    return rows[keep]


def _pcd_parts(content: bytes, path: Path) -> tuple[bytes, bytes, int]:
    """Return head, points, and the bytes of each; 0 for lines."""
    file = io.BytesIO(content)
    header = pcd.read_header(file)
    start, width = file.tell(), header.point.itemsize
    head = ROWS_OF_PCD.sub(rb"\g<1>1", content[:start])
    if header.kind == "ascii":
        return head, content[start:], 0
    if header.kind == "binary":
        return head, content[start : start + header.point_count * width], width
    columns = pcd.read_compressed(file, header)
    points = np.zeros(header.point_count, header.point)
    for name in header.scalars:
        if name not in columns or columns[name].dtype != header.point[name]:
            found = f"compressed values of {name}, which open3d does not keep as they are"
            hint = "write it as binary, by pcl_convert_pcd_ascii_binary for example"
            raise FormatError(path, found, "binary or ascii", hint)
        points[name] = columns[name]
    return COMPRESSED_PCD.sub(rb"\1", head), points.tobytes(), width


def _ply_parts(content: bytes, path: Path) -> tuple[bytes, bytes, int]:
    """Return head, vertices, and the bytes of each; 0 for lines."""
    data, end = ply.read_ply(path, content), END_OF_PLY.search(content)
    vertices = data["vertex"]
    others = [each.name for each in data if each is not vertices and each.count]
    if others or vertices.data.dtype.hasobject or end is None:
        found = f"also holds {', '.join(others) or 'lists'}"
        raise FormatError(path, found, "points only", "save it without, in CloudCompare")
    width = 0 if data.text else vertices.data.itemsize
    body = content[end.end() :]
    return content[: end.end()], body[: width * vertices.count] if width else body, width
