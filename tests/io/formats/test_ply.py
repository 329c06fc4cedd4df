# SPDX-License-Identifier: MIT
import struct
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scans import IN_BYTES, refused

from salsanext_cli import read_scan, write_ply
from salsanext_cli.core.errors import FormatError, MissingDependency

SCALARS = ["?", "u1", "i1", "u2", "i2", "u4", "i4", "i8", "f2", "f4", "f8"]


def header(
    properties: str = "float x,float y,float z,float intensity",
    count: int = 2,
    data: str = "binary_little_endian",
) -> bytes:
    lines = ["ply", f"format {data} 1.0", f"element vertex {count}"]
    lines += [f"property {entry}" for entry in properties.split(",")]
    return "\n".join([*lines, "end_header", ""]).encode()


def elements(kind) -> st.SearchStrategy[object]:
    # float64 is exact for whole numbers up to 2⁵³.
    return st.integers(-(2**53), 2**53) if kind == "i8" else hnp.from_dtype(np.dtype(kind))


@given(st.data())
def test_every_column_survives(tmp_path_factory, data):
    plyfile = pytest.importorskip("plyfile")
    count = data.draw(st.integers(0, 5))
    dtypes = {"x": "f4", "y": "f4", "z": "f4", "red": "u1", "intensity": "f4"}
    dtypes |= {f"scalar_{i}": kind for i, kind in enumerate(SCALARS)}
    arrays = {n: hnp.arrays(kind, count, elements=elements(kind)) for n, kind in dtypes.items()}
    columns = {name: data.draw(array) for name, array in arrays.items()}
    # Elsewhere it would be a map, which is refused.
    for axis in "xy":
        columns[axis][:1] = 1
    path = tmp_path_factory.mktemp("ply") / "s.ply"
    write_ply(path, columns)
    vertices = plyfile.PlyData.read(path)["vertex"]
    assert [p.name for p in vertices.properties] == list(columns)
    for name, values in columns.items():
        np.testing.assert_array_equal(vertices[name], values)
        assert vertices[name].dtype.str in ("|u1", "<i4", "<f4", "<f8")
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points[:, 1], columns["y"])
    np.testing.assert_array_equal(scan.intensity, columns["intensity"])


def test_float64_and_bytes_in_every_encoding(tmp_path):
    for data, row in (
        ("ascii", b"1 2 3 51\n"),
        ("binary_little_endian", struct.pack("<3dB", 1, 2, 3, 51)),
        ("binary_big_endian", struct.pack(">3dB", 1, 2, 3, 51)),
    ):
        path = tmp_path / "s.ply"
        for count in (0, 2):
            properties = "double x,double y,double z,uchar Reflectance"
            path.write_bytes(header(properties, count, data) + row * count)
            scan = read_scan(path, replace(IN_BYTES, intensity_scale=100.0))
            assert scan.points.tolist() == [[1, 2, 3]] * count
            np.testing.assert_array_equal(scan.intensity, np.float32([0.2] * count))


def test_bad_files(tmp_path):
    for content in (
        *(b"", b"ply\n", bytes(range(256)) * 20),
        header() + bytes(31),
        header(data="ascii") + b"1 2 3 4\n",
        header(data="ascii") + b"1 2 3 4\n5 6\n",
        header(data="ascii") + b"1 2 3 4\na b c d\n",
        header("float x,float y") + bytes(16),
        header().replace(b"vertex", b"face") + bytes(32),
        header("float x,float x,float y,float z") + bytes(32),
        header("list uchar int x,float y,float z", 1) + bytes(9),
    ):
        path = tmp_path / "s.ply"
        path.write_bytes(content)
        refused(FormatError, path, read_scan, path)


def test_no_vertices_are_named_and_blanks_at_the_ends_of_lines_are_no_damage(tmp_path):
    path = tmp_path / "s.ply"
    for content in (b"ply \nformat ascii 1.0\nend_header\n", header().replace(b"vertex", b"face")):
        path.write_bytes(content)
        with pytest.raises(FormatError, match="no vertices"):
            read_scan(path)
    path.write_bytes(header().replace(b"1.0\n", b"1.0 \t\n") + struct.pack("<8f", *range(8)))
    assert read_scan(path).points.tolist() == [[0, 1, 2], [4, 5, 6]]


def test_blank_lines_among_ascii_points_are_no_damage(tmp_path):
    path = tmp_path / "s.ply"
    for body in (b"\n1 2 3 4\n5 6 7 8\n", b"1 2 3 4\n \t\n\n5 6 7 8\n\n"):
        for end in (b"\n", b"\r\n", b"\r"):
            content = (header(data="ascii") + body).replace(b"\n", end)
            path.write_bytes(content)
            assert read_scan(path).points.tolist() == [[1, 2, 3], [5, 6, 7]]
    # In binary points the same bytes are values.
    values = struct.pack("<8f", *range(8))
    path.write_bytes(header() + b"\n\n\n\n" + values[4:])
    assert read_scan(path).points[0].tolist() == [*struct.unpack("<f", b"\n\n\n\n"), 1, 2]


def test_missing_plyfile_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plyfile", None)
    with pytest.raises(MissingDependency, match="pip install plyfile"):
        write_ply(tmp_path / "s.ply", {"x": np.zeros(1, np.float32)})
