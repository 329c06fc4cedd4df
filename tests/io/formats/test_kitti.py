# SPDX-License-Identifier: MIT
"""Headerless files: scans with any number of columns, labels, and other files."""

import gzip
import io
import re
import struct

import numpy as np
import pytest
from calls import calls_of
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scans import make_scan, real_columns, real_scans

from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.io.files.reading import read_values
from salsanext_cli.io.formats import kitti
from salsanext_cli.io.formats.kitti_labels import read_labels, write_labels


@pytest.mark.parametrize("count", [40, 41, 42, 43])
@pytest.mark.parametrize(("columns", "suffix"), [(5, ".bin"), (4, ".pcd.bin")])
def test_another_number_of_columns_is_recognised(tmp_path, count, columns, suffix):
    path = tmp_path / f"s{suffix}"
    random = np.random.default_rng(count)
    table = [random.normal(0, 20, (count, 3)), *random.integers(0, (256, 32), (1, count, 2))]
    path.write_bytes(np.hstack(table).astype("<f4")[:, :columns].tobytes())
    with pytest.raises(FormatError) as caught:
        kitti.read_bin(path)
    assert caught.value.hint.startswith(f"rename it to {'.pcd.bin' if columns == 5 else '.bin'},")


def test_negative_intensities_and_signalling_nans_are_read(tmp_path):
    table = np.random.default_rng(0).normal(0, 20, (59, 4)).astype("<f4")
    nan = struct.pack("<3f", 1, 2, 3) + b"\x01\x00\xa0\x7f"
    (tmp_path / "s.bin").write_bytes(table.tobytes() + nan)
    scan = kitti.read_bin(tmp_path / "s.bin", intensity_scale=255)
    assert np.flatnonzero(np.isnan(scan.intensity)).tolist() == [59]


@pytest.mark.slow
@pytest.mark.real
def test_no_real_scan_is_refused(real_data, tmp_path):
    for path in real_scans(real_data):
        columns = real_columns(path)
        link = tmp_path / f"{len(list(tmp_path.iterdir()))}{'.pcd' * (columns == 5)}.bin"
        link.symlink_to(path)
        scan = kitti.read_bin(link)
        assert len(scan) == path.stat().st_size // (4 * columns)
        labels = path.parent.parent / "labels" / f"{path.stem}.label"
        if labels.exists():
            raw = read_labels(labels, len(scan))
            assert raw.any()
            assert raw.max() < 33 or "nuscenes" not in str(path)


@pytest.mark.real
@pytest.mark.parametrize("name", ["semantickitti/sequences/00", "pandaset/sequences/002"])
def test_a_real_scan_with_other_columns_is_refused_with_names_to_try(real_data, tmp_path, name):
    table = np.fromfile(next((real_data / "data" / name / "velodyne").iterdir()), "<f4")
    table = table.reshape(-1, 4)
    random, ones = np.random.default_rng(0), np.ones((len(table), 1), np.float32)
    normals = random.normal(size=(len(table), 3))
    path = tmp_path / "s.bin"
    for columns in (
        [table[:, :3]],
        [table, normals],
        [table, random.integers(0, 256, (len(table), 3)), ones],
        [table[:, :3], ones, table[:, 3:], 0 * normals],
        [table, 0 * ones, np.arange(len(table))[:, None] % 64, 0 * normals],
    ):
        path.write_bytes(np.hstack(columns).astype("<f4").tobytes())
        with pytest.raises(FormatError) as caught:
            kitti.read_bin(path)
        (names,) = re.findall(r'columns="(\S+)"', caught.value.hint)
        scan = kitti.read_bin(path, columns=tuple(names.split(",")))
        np.testing.assert_array_equal(scan.points, table[:, :3])


@given(hnp.arrays(np.uint32, st.integers(0, 50)))
def test_labels_survive_the_round_trip(tmp_path_factory, raw):
    path = tmp_path_factory.mktemp("label") / "s.label"
    write_labels(path, raw)
    assert path.read_bytes() == b"".join(struct.pack("<I", value) for value in raw.tolist())
    np.testing.assert_array_equal(read_labels(path, len(raw)), raw)
    with pytest.raises(LabelError, match=rf"{len(raw)} labels? \(expected {len(raw) + 53}"):
        read_labels(path, len(raw) + 53)
    path.write_bytes(path.read_bytes() + b"cut")
    with pytest.raises(FormatError, match=f"{4 * len(raw) + 3} bytes"):
        read_labels(path)


@pytest.mark.parametrize("kind", ["<u4", "<u2", "u1"])
def test_labels_of_one_two_or_four_bytes(tmp_path, kind):
    path = tmp_path / "s.label"
    raw = np.arange(100, dtype=kind)
    path.write_bytes(raw.tobytes())
    read = read_labels(path, 100)
    assert read.dtype == np.uint32
    np.testing.assert_array_equal(read, raw)
    with pytest.raises(LabelError, match=r"\d+ labels \(expected 99"):
        read_labels(path, 99)
    if raw.itemsize < 4:
        path.write_bytes(np.arange(25 * raw.itemsize, dtype="<u4").tobytes())
        with pytest.raises(LabelError, match=r"\d+ labels \(expected 100"):
            read_labels(path, 100)
        path.write_bytes(bytes(100 * raw.itemsize))
        assert not read_labels(path, 100).any()
    path.write_bytes(raw.tobytes())
    # Without the number of points they are four.
    assert len(read_labels(path)) == raw.nbytes // 4


SCAN = make_scan(3000)
TABLE = np.column_stack([SCAN.points, SCAN.intensity])
RING = np.arange(3000)[:, None] % 64


def npy(table):
    with io.BytesIO() as file:
        np.save(file, table)
        return file.getvalue()


LINES = "".join(f"{x:.3f} {y:.3f} {z:.3f} {i:.2f}\n" for x, y, z, i in TABLE).encode()
OTHERS = {
    "empty": (b"", "is empty"),
    "text": (LINES[: len(LINES) // 16 * 16], "is text"),
    "a short text": ("Grüße aus Köln!\n".encode() * 16, "is text"),
    "ply": (b"ply\nformat binary_little_endian 1.0\n" + bytes(16 * 99), "is a .ply file"),
    "npy": (npy(TABLE), "is a .npy file"),
    "gzip": (gzip.compress(kitti.encode_bin(SCAN)), "is a gzip file"),
    "float64, five columns": (np.hstack([TABLE, RING]).astype("<f8").tobytes(), "5 columns"),
    "float64, cut off": (TABLE.astype("<f8").tobytes()[:-8], "95992 bytes"),
    "float16": (TABLE.astype("<f2").tobytes(), "looks like float16"),
    "five planes": (np.hstack([TABLE, RING]).T.astype("<f4").tobytes(), "column by column"),
    "millimetres as int32": ((TABLE * 1000).astype("<i4").tobytes(), "not coordinates"),
    "big endian": (TABLE.astype(">f4").tobytes(), "not coordinates"),
    "random": (np.random.default_rng(0).bytes(48_000), "not coordinates"),
}


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("columns", [(), ("x", "y", "z", "intensity")])
def test_other_content_is_refused(tmp_path, name, columns):
    content, problem = OTHERS[name]
    path = tmp_path / "s.bin"
    path.write_bytes(content if isinstance(content, bytes) else content.tobytes())
    with pytest.raises(FormatError) as caught:
        kitti.read_bin(path, columns=columns)
    assert problem in caught.value.problem
    assert "\n" not in caught.value.headline


UNUSUAL = {
    "nothing measured": np.zeros((500, 4)),
    "two thirds zeros": np.where(np.random.default_rng(1).random((3000, 1)) < 2 / 3, 0, TABLE),
    "one plane": TABLE * [1, 1, 0, 1],
    "millimetres": TABLE * 1000,
    "one point": TABLE[:1],
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_unusual_points_are_read(tmp_path, name):
    path = tmp_path / "s.bin"
    table = UNUSUAL[name].astype("<f4")
    path.write_bytes(table.tobytes())
    np.testing.assert_array_equal(kitti.read_bin(path).points, table[:, :3])


@pytest.mark.parametrize("columns", [(), ("x", "y", "z", "intensity")])
@pytest.mark.parametrize("kind", ["<f4", "<f8"])
@pytest.mark.parametrize("origin", [(15e3, 0, 0), (5e5, 5.6e6, 300)])
def test_map_coordinates_are_refused(tmp_path, columns, kind, origin):
    path = tmp_path / "s.bin"
    path.write_bytes((TABLE + [*origin, 0]).astype(kind).tobytes())
    with pytest.raises(FormatError, match="map coordinates: x from") as caught:
        kitti.read_bin(path, columns=columns)
    assert "subtract" in caught.value.hint


@pytest.mark.parametrize("share", [0, 0.2, 0.6])
@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_points_that_were_not_measured_leave_the_type_evident(tmp_path, kind, share):
    path = tmp_path / "s.bin"
    table = TABLE.astype(kind).round(3)
    table[np.random.default_rng(0).random(len(table)) < share] = np.nan
    path.write_bytes(table.tobytes())
    np.testing.assert_array_equal(kitti.read_bin(path).points, table[:, :3].astype("f4"))
    assert kitti.count_points(path) == len(table)


@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_points_are_counted_by_a_part_of_the_file(tmp_path, kind):
    path, table = tmp_path / "s.bin", np.tile(TABLE.astype(kind).round(3), (10, 1))
    path.write_bytes(table.tobytes())
    with calls_of(read_values) as reads:
        assert kitti.count_points(path) == len(table)
    sizes = [np.dtype(call["dtype"]).itemsize * call["count"] for call in reads]
    assert 0 < sum(sizes) < path.stat().st_size / 5


def test_any_columns(tmp_path):
    path = tmp_path / "s.bin"
    table = np.hstack([RING, TABLE[:, 3:] * 255, TABLE[:, :3], -TABLE[:, :2]]).astype("<f4")
    path.write_bytes(table.tobytes())
    names = ("ring", "intensity", "x", "y", "z", "_", "_")
    scan = kitti.read_bin(path, columns=names, intensity_scale=255)
    np.testing.assert_array_equal(scan.points, SCAN.points)
    np.testing.assert_allclose(scan.intensity, SCAN.intensity, rtol=1e-6)
    for columns, cut, sizes in (((*names, "_", "_"), 0, (7, 9)), (names, 4, (83996, 28))):
        path.write_bytes(table.tobytes()[: table.nbytes - cut])
        with pytest.raises(FormatError, match=r"{}.*expected .*{}".format(*sizes)):
            kitti.read_bin(path, columns=columns)
    path.write_bytes(SCAN.points.tobytes())
    assert not kitti.read_bin(path, columns=("x", "y", "z")).intensity.any()


@pytest.mark.parametrize("columns", [(), ("x", "y", "z", "intensity")])
@pytest.mark.parametrize("layout", ["decimals", "dyadic", "planar", "planar float64"])
def test_float64_and_planar_files_are_read_with_a_notice(tmp_path, caplog, columns, layout):
    log_once.cache_clear()
    caplog.set_level(NOTICE, "salsanext_cli")
    table = np.column_stack([SCAN.points, SCAN.intensity]).astype("<f8")
    table = np.rint(table * 128) / 128 if layout == "dyadic" else table.round(3)
    stored = table.T if "planar" in layout else table
    kind = "<f4" if layout == "planar" else "<f8"
    (tmp_path / "s.bin").write_bytes(stored.astype(kind).tobytes())
    scan = kitti.read_bin(tmp_path / "s.bin", columns)
    np.testing.assert_array_equal(scan.points, table[:, :3].astype("f4"))
    np.testing.assert_array_equal(scan.intensity, table[:, 3].astype("f4"))
    assert ("float64" in caplog.text) == (kind == "<f8")
    assert ("one after the other" in caplog.text) == ("planar" in layout)


def test_the_hints_of_other_types_and_orders_work(tmp_path):
    for name, table in {
        "float16": TABLE.astype("<f2"),
        "planes": np.hstack([TABLE, RING]).T.astype("<f4"),
    }.items():
        old, new = tmp_path / f"{name}.bin", tmp_path / f"{name}_new.bin"
        old.write_bytes(table.tobytes())
        with pytest.raises(FormatError) as caught:
            kitti.read_bin(old)
        code = caught.value.hint.removesuffix(" converts it")
        eval(code, {"np": np, "FILE": old, "NEW": new, "COLUMNS": 5})
        names = ("x", "y", "z", "intensity", "ring")[: 4 if name == "float16" else 5]
        points = table.reshape(5, -1).T[:, :3] if name == "planes" else table[:, :3]
        np.testing.assert_array_equal(kitti.read_bin(new, names).points, points.astype("f4"))
    with pytest.raises(FormatError, match="no names") as caught:
        kitti.read_bin(new, intensity_field="ring")
    assert 'columns="' in caught.value.hint
    scan = kitti.read_bin(new, names, 63.0, "ring")
    np.testing.assert_array_equal(scan.intensity, np.float32(RING[:, 0]) / np.float32(63))


def test_unmeasured_returns_that_recur_are_no_further_columns(tmp_path, caplog):
    log_once.cache_clear()
    caplog.set_level(NOTICE, "salsanext_cli")
    path, rows = tmp_path / "s.bin", TABLE.astype("<f4")
    for order in (rows, np.random.default_rng(0).permutation(rows)):
        dual = np.zeros((len(order), 2, 4), np.float32)
        dual[:, 0] = order
        path.write_bytes(dual.tobytes())
        np.testing.assert_array_equal(kitti.read_bin(path).points[::2], order[:, :3])
        names = re.search(r'columns="(\S+)"', caplog.text)[1]
        scan = kitti.read_bin(path, tuple(names.split(",")))
        np.testing.assert_array_equal(scan.points, order[:, :3])
        for lost in (np.inf, -np.inf, np.nan):
            third = order.copy()
            third[::3, :3] = lost
            path.write_bytes(third.tobytes())
            np.testing.assert_array_equal(kitti.read_bin(path).points, third[:, :3])
