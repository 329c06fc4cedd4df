# SPDX-License-Identifier: MIT
"""Files of scans with some of their points: their headers, then the points as they are."""

import copy
import gzip
import io
import re
from collections.abc import Callable
from functools import partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, LabelError, counted
from salsanext_cli.files.reading import reading, refusing_damage
from salsanext_cli.formats import kitti, las, numpy_scans, pcd, ply, scan_suffix, text
from salsanext_cli.formats.feather import feather_subset, read_table
from salsanext_cli.formats.npy import load_npy
from salsanext_cli.records import Mask

NUMBERS = re.compile(rb"(?m)^(\s*(?:WIDTH|POINTS|element\s+vertex)\s+)\d+")
NUMBER_ALONE = re.compile(rb"(?m)^(\s*)\d+(?=\s*$)")
ROWS_OF_PCD = re.compile(rb"(?m)^(\s*HEIGHT\s+)\d+")
COMPRESSED_PCD = re.compile(rb"(?mi)^(\s*DATA\s+binary)_compressed")
END_OF_PLY = re.compile(rb"end_header(?:\r\n|\r|\n)")


def subsets_of(path: Path, names: tuple[str, ...] = ()) -> Callable[[Mask], bytes]:
    """Read a scan file; return what gives its content with the points only that stay, (N,) bool.

    Header, order and values stay; an organised PCD cloud becomes one row, a compressed one binary.
    `names`: of the columns of files that do not name them.
    """
    suffix = scan_suffix(path.name)
    if suffix in (".las", ".laz"):
        return partial(_las_subset, path, *las.read_points(path, further_records=True))
    if suffix == ".npy":
        return partial(_npy_subset, path, load_npy(path, numpy_scans.EXPECTED), len(names))
    if suffix == ".npz":
        return partial(_npz_subset, path, *numpy_scans.npz_arrays(path))
    if suffix == ".feather":
        table = read_table(path)
        return lambda keep: feather_subset(table, _kept(np.arange(len(table)), keep, path))
    number, width = NUMBERS, 0
    with reading(path) as file, refusing_damage(path, f"a whole {suffix} file"):
        head, body = b"", file.read()
        match suffix:
            case ".pcd":
                head, body, width = _pcd_parts(body, path)
            case ".ply":
                head, body, width = _ply_parts(body, path)
            case ".bin" | ".pcd.bin" | ".bin.gz" | ".pcd.bin.gz":
                if suffix.endswith(kitti.GZIP_SUFFIX):
                    body = kitti.decompressed(io.BytesIO(body), path)[0].getvalue()
                width = 4 * (len(names) or kitti.usual_width(path))
            case _:
                mark = len(body) - len(body.removeprefix(text.BYTE_ORDER_MARK))
                layout = text.layout_of(body[mark:], has_names=bool(names))
                head, body = body[: mark + layout.start], body[mark + layout.start :]
                number = NUMBER_ALONE if layout.count is not None else NUMBERS
    lines = [] if width else [line for line in body.splitlines(keepends=True) if line.strip()]
    whole = len(body) // width * width if width else 0
    rows = np.frombuffer(body[:whole], f"V{width}") if width else np.empty(len(lines))
    head = ROWS_OF_PCD.sub(rb"\g<1>1", head)

    def subset(keep: Mask) -> bytes:
        kept = _kept(rows, keep, path)
        points = kept.tobytes() if width else b"".join(compress(lines, keep.tolist()))
        content = number.sub(rb"\g<1>%d" % len(kept), head) + points
        return gzip.compress(content) if suffix.endswith(kitti.GZIP_SUFFIX) else content

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
    if header.kind == "ascii":
        return content[:start], content[start:], 0
    if header.kind == "binary":
        return content[:start], content[start : start + header.point_count * width], width
    columns = pcd.read_compressed(file, header)
    points = np.zeros(header.point_count, header.point)
    for name in header.scalars:
        if name not in columns or columns[name].dtype != header.point[name]:
            found = f"compressed values of {name}, which open3d does not keep as they are"
            remedy = "write it as binary, by pcl_convert_pcd_ascii_binary for example"
            raise FormatError(path, found, "binary or ascii", remedy)
        points[name] = columns[name]
    return COMPRESSED_PCD.sub(rb"\1", content[:start]), points.tobytes(), width


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


def _npy_subset(path: Path, table: npt.NDArray[Any], columns: int, keep: Mask) -> bytes:
    transposed = numpy_scans.is_transposed(table, columns)
    with io.BytesIO() as buffer:
        np.save(buffer, _kept(table.T, keep, path).T if transposed else _kept(table, keep, path))
        return buffer.getvalue()


def _npz_subset(
    path: Path, arrays: dict[str, npt.NDArray[Any]], compressed: bool, keep: Mask
) -> bytes:
    """Return an archive in which all arrays of N rows or columns are of the points that stay."""
    of_points = {name: each[keep] for name, each in arrays.items() if each.shape[:1] == keep.shape}
    of_points |= {
        name: each[:, keep]
        for name, each in arrays.items()
        if each.ndim == 2 and each.shape[1:] == keep.shape != each.shape[:1]
    }
    _kept(keep[: len(keep) * bool(of_points)], keep, path)
    save: Any = np.savez_compressed if compressed else np.savez
    with io.BytesIO() as buffer:
        save(buffer, **arrays | of_points)
        return buffer.getvalue()


def _las_subset(path: Path, header: Any, points: Any, keep: Mask) -> bytes:
    _kept(points.array, keep, path)
    compressed = header.are_points_compressed
    laspy = las.import_laspy(path, compressed=compressed)
    backend = laspy.LazBackend.Lazrs if compressed else None
    with io.BytesIO() as buffer:
        cloud = laspy.LasData(copy.deepcopy(header), points[keep])
        cloud.write(buffer, do_compress=compressed, laz_backend=backend)
        return buffer.getvalue()
