# SPDX-License-Identifier: MIT
"""Files of scans with some of their points: their headers, then the points as they are."""

import io
import re
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, LabelError, counted
from salsanext_cli.files.reading import reading, refusing_damage
from salsanext_cli.formats import kitti, las, numpy_scans, pcd, ply, scan_suffix, text

Mask = npt.NDArray[np.bool_]
NUMBERS = re.compile(rb"(?m)^(\s*(?:WIDTH|POINTS|element\s+vertex)\s+)\d+")
NUMBER_ALONE = re.compile(rb"(?m)^(\s*)\d+(?=\s*$)")
ROWS_OF_PCD = re.compile(rb"(?m)^(\s*HEIGHT\s+)\d+")
COMPRESSED_PCD = re.compile(rb"(?mi)^(\s*DATA\s+binary)_compressed")
END_OF_PLY = re.compile(rb"end_header(?:\r\n|\r|\n)")


def kept_points(path: Path, keep: Mask, names: tuple[str, ...] = ()) -> bytes:
    """Return the content of a scan file with the points only that stay, (N,) bool.

    Header, order and values stay; an organised PCD cloud becomes one row, a compressed one binary.
    `names`: of the columns of files that do not name them.
    """
    suffix = scan_suffix(path.name)
    if suffix in (".las", ".laz", ".npy", ".npz"):
        return _by_library(path, suffix, keep)
    with reading(path) as file, refusing_damage(path, f"a whole {suffix} file"):
        content = file.read()
        count, head, number, width = int(keep.sum()), b"", NUMBERS, 0
        match suffix:
            case ".pcd":
                head, body, width = _pcd_parts(content, path)
            case ".ply":
                head, body, width = _ply_parts(content, path)
            case ".bin" | ".pcd.bin":
                usual = kitti.COLUMNS_WITH_RING if suffix == ".pcd.bin" else kitti.COLUMNS
                body, width = content, 4 * (len(names) or usual)
            case _:
                mark = len(content) - len(content.removeprefix(text.BYTE_ORDER_MARK))
                layout = text.layout_of(content[mark:], has_names=bool(names))
                head, body = content[: mark + layout.start], content[mark + layout.start :]
                number = NUMBER_ALONE if layout.count is not None else NUMBERS
    head = ROWS_OF_PCD.sub(rb"\g<1>1", number.sub(rb"\g<1>%d" % count, head))
    if width:
        return (
            head
            + _kept(
                np.frombuffer(body[: len(body) // width * width], f"V{width}"), keep, path
            ).tobytes()
        )
    lines = [line for line in body.splitlines(keepends=True) if line.strip()]
    _kept(np.empty(len(lines)), keep, path)
    return head + b"".join(compress(lines, keep.tolist()))


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


def _by_library(path: Path, suffix: str, keep: Mask) -> bytes:
    """Return the content of a LAS, LAZ or numpy file; what has N rows in an archive is points'."""
    with io.BytesIO() as buffer:
        if suffix == ".npy":
            np.save(buffer, _kept(numpy_scans.npy_table(path), keep, path))
        elif suffix == ".npz":
            arrays, compressed = numpy_scans.npz_arrays(path)
            of_points = [name for name, array in arrays.items() if array.shape[:1] == keep.shape]
            _kept(keep[: len(keep) * bool(of_points)], keep, path)
            arrays |= {name: arrays[name][keep] for name in of_points}
            save: Any = np.savez_compressed if compressed else np.savez
            save(buffer, **arrays)
        else:
            header, points = las.read_points(path, further_records=True)
            _kept(points.array, keep, path)
            compressed = header.are_points_compressed
            laspy = las.import_laspy(path, compressed=compressed)
            backend = laspy.LazBackend.Lazrs if compressed else None
            cloud = laspy.LasData(header, points[keep])
            cloud.write(buffer, do_compress=compressed, laz_backend=backend)
        return buffer.getvalue()
