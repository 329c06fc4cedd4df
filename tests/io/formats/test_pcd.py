# SPDX-License-Identifier: MIT
import struct
import sys
from dataclasses import replace

import numpy as np
import pytest
from scans import IN_BYTES, refused

from salsanext_cli.core.errors import FormatError, MissingDependency
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.subsets import subsets_of


def header(fields="x:F4 y:F4 z:F4 intensity:F4", points=2, data="binary"):
    parts = [(*field.split(":"), "1") for field in fields.split()]
    names, kinds, counts = zip(*(part[:3] for part in parts), strict=True)
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {' '.join(names)}\n"
        f"SIZE {' '.join(kind[1:] for kind in kinds)}\n"
        f"TYPE {' '.join(kind[0] for kind in kinds)}\nCOUNT {' '.join(counts)}\n"
        f"WIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
    ).encode()


def stored_as_literals(plain) -> bytes:
    """Pack without compressing: LZF allows runs of up to 32 literal bytes."""
    runs = [plain[i : i + 32] for i in range(0, len(plain), 32)]
    packed = b"".join(bytes([len(run) - 1]) + run for run in runs)
    return struct.pack("<II", len(packed), len(plain)) + packed


def reordered(head):
    """Return a header whose HEIGHT comes after POINTS."""
    return head.replace(b"HEIGHT 1\n", b"").replace(b"DATA", b"HEIGHT 1\nDATA")


def test_padding_and_fields_of_several_values(tmp_path):
    path = tmp_path / "s.PCD"
    row = struct.Struct("<ff4xfB3xf8xd")
    fields = "x:F4 y:F4 _:U1:4 z:F4 intensity:U1 _:U1:3 ring:F4 normal:F4:2 _:U1:0 t:F8"
    rows = row.pack(1, 2, 3, 255, 9, 0.5) + row.pack(-1, np.nan, 0, 51, 9, 0.5)
    path.write_bytes(header(fields) + rows + b"page filling")
    scan = read_scan(path, replace(IN_BYTES, intensity_scale=7.0))
    np.testing.assert_array_equal(scan.points, np.float32([[1, 2, 3], [-1, np.nan, 0]]))
    np.testing.assert_array_equal(scan.intensity, np.float32([1, 0.2]))


def test_ascii_and_an_old_header_without_count_and_points(tmp_path):
    path = tmp_path / "s.pcd"
    fields = "x:F4 y:F4 z:F4 normal:F4:2 intensity:U1"
    path.write_bytes(header(fields, data="ascii") + b"1 nan 3 0 0 51\r\n-0 5 inf 0 0 255\r\n")
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, np.float32([[1, np.nan, 3], [0, 5, np.inf]]))
    np.testing.assert_array_equal(scan.intensity, np.float32([0.2, 1]))
    path = tmp_path / "s.pcd"
    lines = header(data="ascii").split(b"\n")
    kept = [line for line in lines if not line.startswith((b"COUNT", b"POINTS"))]
    path.write_bytes(b"\n".join(kept) + b"1 2 3 4\n5 6 7 8\n")
    assert read_scan(path).intensity.tolist() == [4, 8]


def test_keywords_and_types_in_lower_case(tmp_path):
    path = tmp_path / "s.pcd"
    head = header("x:f4 y:f4 z:f4 intensity:u1").replace(b"FIELDS", b"fields")
    path.write_bytes(head + struct.pack("<3fB", 1, 2, 3, 51) * 2)
    np.testing.assert_array_equal(read_scan(path).points, [[1, 2, 3]] * 2)
    np.testing.assert_array_equal(read_scan(path).intensity, np.float32([0.2] * 2))
    kept = subsets_of(path)(np.array([True, False]))
    assert kept.endswith(struct.pack("<3fB", 1, 2, 3, 51))
    assert b"POINTS 1\n" in kept


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_clouds_without_points_or_intensity_and_of_large_float64(tmp_path, data):
    path = tmp_path / "s.pcd"
    for rows in ([], [(1e300, 2, 3)]):
        plain = b"".join(struct.pack("<3d", *row) for row in rows)
        text = "".join(f"{x} {y} {z}\n" for x, y, z in rows).encode()
        packed = stored_as_literals(plain)
        body = {"ascii": text, "binary": plain, "binary_compressed": packed}[data]
        path.write_bytes(header("x:F8 y:F8 z:F8", len(rows), data) + body)
        scan = read_scan(path)
        assert scan.points.tolist() == [[np.inf, 2, 3]] * len(rows)
        assert scan.intensity.tolist() == [0] * len(rows)


@pytest.mark.parametrize("spoil", [bytes, lambda h: h.replace(b"_c", b"_C"), reordered])
def test_compressed(tmp_path, spoil):
    """Open3d reads other values if DATA is in upper case, and crashes if HEIGHT comes last."""
    path = tmp_path / "gepäck 1.pcd"
    plain = struct.pack("<6f2B", 1, 4, 2, 5, 3, np.inf, 51, 255)
    head = header("x:F4 y:F4 z:F4 intensity:U1", data="binary_compressed")
    path.write_bytes(spoil(head) + stored_as_literals(plain))
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, np.float32([[1, 2, 3], [4, 5, np.inf]]))
    np.testing.assert_array_equal(scan.intensity, np.float32([0.2, 1]))


def test_bad_files(tmp_path, capfd):
    for content, found in (
        (b"", "no PCD header"),
        (b"bytes\x00\xff" * 20000, "no PCD header"),
        (b"# .PCD v0.7\nDATA binary\n", "no line FIELDS, SIZE, TYPE"),
        (header("a:F4 b:F4 z:F4") + bytes(24), "columns a, b, z"),
        (header("x:F4 x:F4 y:F4 z:F4") + bytes(32), "more than once"),
        (header("x:F3 y:F4 z:F4") + bytes(22), "header: TYPE and SIZE F 3"),
        (header().replace(b"SIZE 4 4 4 4", b"SIZE 4 4 4") + bytes(32), "4 FIELDS, 3 SIZE"),
        (header().replace(b"POINTS 2", b"POINTS two") + bytes(32), "unusable header"),
        (header(data="zipped") + bytes(32), "DATA zipped"),
        (header() + bytes(31), "31 bytes of data, not 32"),
        (header(data="ascii") + b"1 2 3 4", "cut off: 1 of 2 points"),
        (header(data="ascii"), "cut off: 0 of 2 points"),
        (header(data="ascii") + b"1,5 2,5 3,5 4,5\n" * 2, "decimal commas: 1,5"),
        (header(data="ascii") + b"1 2 3 4\na b c d\n", "line 13 has 'a'"),
        (header(data="binary_compressed") + struct.pack("<II", 50, 32) + bytes(9), "9 bytes"),
        (
            header(data="binary_compressed") + struct.pack("<II", 9, 32) + b"\xff" * 9,
            "cannot be unpacked",
        ),
        (
            header("x:F4 y:F4 z:F4 n:F4:2", data="binary_compressed")
            + stored_as_literals(bytes(40)),
            "several values",
        ),
    ):
        path = tmp_path / "s.pcd"
        path.write_bytes(content)
        caught = refused(FormatError, path, read_scan, path)
        assert found in caught.value.problem
        # The points of such a file may be complete.
        is_unusable = "header" in caught.value.problem or "DATA" in caught.value.problem
        assert not (is_unusable and "damaged" in caught.value.problem)
        assert capfd.readouterr() == ("", ""), "open3d prints by itself"


def test_missing_system_library_is_named(tmp_path, monkeypatch):
    (tmp_path / "open3d.py").write_text("raise OSError('libusb-1.0.so.0: cannot open')")
    path = tmp_path / "s.pcd"
    path.write_bytes(header(data="binary_compressed") + stored_as_literals(bytes(32)))
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.split(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(MissingDependency, match=r"libusb-1\.0-0"):
        read_scan(path)
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingDependency, match="pip install open3d"):
        read_scan(path)
