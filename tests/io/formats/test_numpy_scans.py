# SPDX-License-Identifier: MIT
import io
import tracemalloc
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scans import SMALL, named_by_hint

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.subsets import subsets_of

TABLE = np.array([[1, -2, 3, 51], [4, 5, -6, 255]], np.float32)


@given(
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=3, max_side=5),
    st.sampled_from(["<f4", ">f4", "<f8", "<f2", "<i2", ">i4", "u1"]),
    st.sampled_from("CF"),
)
def test_tables_of_any_type_and_order(tmp_path_factory, shape, kind, order):
    path = tmp_path_factory.mktemp("npy") / "s.npy"
    table = np.arange(shape[0] * shape[1]).reshape(shape).astype(kind, order)
    np.save(path, table)
    scan = read_scan(path)
    np.testing.assert_array_equal(scan.points, np.float32(table[:, :3]))
    divisor = np.float32(255 if kind == "u1" else 1)
    expected = np.float32(table[:, 3]) / divisor if shape[1] > 3 else np.zeros(shape[0])
    np.testing.assert_array_equal(scan.intensity, expected)
    assert scan.points.flags.writeable


def test_fields_have_names(tmp_path):
    kind = [
        ("t", "u8"),
        ("rgb", "u1", 3),
        ("Z", "f8"),
        ("y", "i4"),
        ("x", "f4"),
        ("intensity", "u1"),
    ]
    table = np.zeros(2, kind)
    for name, values in zip(("x", "y", "Z", "intensity"), TABLE.T, strict=True):
        table[name] = values
    np.save(tmp_path / "s.npy", table)
    scan = read_scan(tmp_path / "s.npy", replace(SMALL, columns=("x", "y", "z")))
    np.testing.assert_array_equal(scan.points, TABLE[:, :3])
    np.testing.assert_array_equal(scan.intensity, np.float32([0.2, 1]))


X, Y, Z, INTENSITY = TABLE.T
ARCHIVES = {
    "columns": {"x": X, "y": Y, "Z": Z, "intensity": INTENSITY, "transform": np.eye(4)},
    "one table": {"arr_0": TABLE},
    "table and column": {"points": TABLE[:, :3], "intensity": INTENSITY},
    "table and (N, 1)": {"cloud": TABLE[:, :3], "Intensity": INTENSITY[:, None]},
    "several tables": {"rgb": np.ones((2, 3)), "points": TABLE},
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("name", ARCHIVES)
def test_archives(tmp_path, name, save):
    save(tmp_path / "s.npz", **ARCHIVES[name])
    scan = read_scan(tmp_path / "s.npz", replace(SMALL, intensity_scale=255.0))
    np.testing.assert_array_equal(scan.points, TABLE[:, :3])
    np.testing.assert_array_equal(scan.intensity, np.float32([0.2, 1]))


def test_other_arrays_are_refused(tmp_path):
    for array, problem, hint in (
        (np.zeros(9), "float64 (9,)", ""),
        (np.zeros((4, 5, 64), "<f4"), "float32 (4, 5, 64)", ""),
        (np.zeros((2, 3), [("x", "f4"), ("y", "f4")]), "columns x, y", ""),
        (np.zeros((5, 7)), "7 columns", 'columns="x,y,z,intensity,_,_,_"'),
        (np.zeros((5, 100)), "100 columns", "at most 64"),
        (np.zeros((9, 4), np.complex64), "complex64", ""),
        (np.array([[{}, 1, 2]], object), "object", ""),
        (np.zeros(3, [("a", "f4"), ("y", "f4")]), "columns a, y", ""),
        (np.full((9, 3), 5e5), "map coordinates", ""),
        (np.zeros((9, 3), "V0"), "V0", ""),
    ):
        np.save(tmp_path / "s.npy", array, allow_pickle=True)
        with pytest.raises(FormatError) as caught:
            read_scan(tmp_path / "s.npy")
        assert problem in caught.value.problem
        assert hint in caught.value.hint


ORGANISED = np.arange(4 * 5 * 6, dtype="<f4").reshape(4, 5, 6)
"""Rows, columns and six values of each pixel."""


def test_organised_clouds_are_read_row_by_row(tmp_path):
    path = tmp_path / "s.npy"
    np.save(path, ORGANISED[..., :4])
    rows = np.array([pixel[:4] for row in ORGANISED for pixel in row])
    np.testing.assert_array_equal(read_scan(path).points, rows[:, :3])
    np.testing.assert_array_equal(read_scan(path).intensity, rows[:, 3])
    kept = np.arange(20) % 3 == 0
    path.write_bytes(subsets_of(path)(kept))
    np.testing.assert_array_equal(read_scan(path).points, rows[kept, :3])
    records = np.zeros((4, 5), [("y", "f4"), ("x", "f4"), ("z", "f4")])
    for name, values in zip("xyz", np.moveaxis(ORGANISED, -1, 0), strict=False):
        records[name] = values
    np.save(path, records)
    np.testing.assert_array_equal(read_scan(path).points, rows[:, :3])


def test_one_hint_names_the_columns_of_an_organised_cloud(tmp_path):
    path = tmp_path / "s.npy"
    np.save(path, ORGANISED)
    names = named_by_hint(path)
    assert len(names) == 6
    scan = read_scan(path, replace(SMALL, columns=names))
    np.testing.assert_array_equal(scan.points, ORGANISED.reshape(-1, 6)[:, :3])


A2D2 = {
    "pcloud_points": TABLE[:, :3].astype("f8"),
    "pcloud_attr.reflectance": np.array([9, 200]),
    "pcloud_attr.row": np.ones(2),
    "pcloud_attr.valid": np.ones(2, bool),
}


def test_fields_behind_a_prefix_are_known(tmp_path):
    np.savez(tmp_path / "s.npz", **A2D2)
    scan = read_scan(tmp_path / "s.npz")
    np.testing.assert_array_equal(scan.points, TABLE[:, :3])
    np.testing.assert_array_equal(scan.intensity, [9, 200])
    assert scan.notes.fields == ("pcloud_attr.row",)


def test_archives_without_one_scan(tmp_path):
    for arrays, problem in (
        ({}, "empty"),
        ({"a": TABLE, "b": TABLE}, "arrays a, b"),
        ({"points": TABLE[:, :3], "intensity": INTENSITY[:1]}, "columns of 1 and of 2 points"),
        ({"x": X, "y": Y[:1], "z": Z}, "columns of 1 and of 2 points"),
        ({f"arr_{i}": X[: 1 + i] for i in range(3)}, "columns of 1 and of 2 points"),
        ({f"arr_{i}": X for i in range(6)}, "6 columns"),
        ({"arr_0": X, "b": Y, "c": Z}, "arrays arr_0, b, c"),
    ):
        np.savez(tmp_path / "s.npz", **arrays)
        with pytest.raises(FormatError, match=problem):
            read_scan(tmp_path / "s.npz")


def test_archives_that_are_cut_or_state_too_much(tmp_path):
    path = tmp_path / "s.npz"
    np.savez(path, points=TABLE)
    content = path.read_bytes()
    path.write_bytes(content[:-5])
    with pytest.raises(FormatError, match="damaged or cut off"):
        read_scan(path)
    zeros = io.BytesIO()
    np.save(zeros, np.zeros((1 << 22, 4), np.float32))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", zeros.getvalue())
    with pytest.raises(FormatError, match="damaged or cut off"):
        read_scan(path)
    np.save(tmp_path / "s.npy", TABLE)
    (tmp_path / "s.npy").write_bytes((tmp_path / "s.npy").read_bytes()[:-1])
    with pytest.raises(FormatError, match=r"31 bytes of data \(expected 32"):
        read_scan(tmp_path / "s.npy")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("offset", [20, 24], ids=["packed", "unpacked"])
def test_an_archive_that_states_gigabytes_is_refused_before_they_are_allocated(
    tmp_path, save, offset
):
    """The directory at the end of an archive states both sizes of each array."""
    path = tmp_path / "s.npz"
    save(path, points=TABLE)
    content = bytearray(path.read_bytes())
    place = content.index(b"PK\x01\x02") + offset
    content[place : place + 4] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    tracemalloc.start(1)
    try:
        with pytest.raises(FormatError, match="damaged or cut off"):
            read_scan(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
