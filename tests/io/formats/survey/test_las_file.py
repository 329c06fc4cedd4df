# SPDX-License-Identifier: MIT
"""LAS and LAZ files that laspy wrote, compared with the arrays that it got."""

import struct
import sys

import numpy as np
import pytest
from las_files import write_las
from scans import make_scan, refused

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError, MissingDependency
from salsanext_cli.io.files.reading import PANIC
from salsanext_cli.io.formats.survey.las_file import las_columns, read_classification

laspy = pytest.importorskip("laspy")
pytest.importorskip("lazrs")
SCALE_OF_X = 131  # Position in the header
SUFFIXES = (".las", ".laz")
SCAN = make_scan(700)
WORDS = np.rint(SCAN.intensity * 65535).astype(np.uint16)
UTM = (500_123.4, 5_400_456.7, 312.0)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", range(11))
def test_every_point_format_has_the_points_and_16_bit_intensities(tmp_path, suffix, kind):
    path = write_las(tmp_path / f"s{suffix}", SCAN.points, WORDS, kind=kind, offsets=(5, -7, 100))
    scan = read_scan(path)
    assert np.abs(scan.points - SCAN.points).max() < 0.51e-3
    np.testing.assert_array_equal(scan.intensity, WORDS.astype(np.float32) / np.float32(65535))
    assert scan.notes.frame == (0, 0, 0)
    assert "classification" in scan.notes.fields


def test_coordinates_beyond_float64_are_no_measurements(tmp_path):
    path = write_las(tmp_path / "s.las", SCAN.points)
    content = bytearray(path.read_bytes())
    content[SCALE_OF_X : SCALE_OF_X + 8] = struct.pack("<d", 1e308)
    path.write_bytes(content)
    points = read_scan(path).points
    assert not np.isfinite(points[np.abs(SCAN.points[:, 0]) > 0.01, 0]).any()
    assert np.abs(points[:, 1:] - SCAN.points[:, 1:]).max() < 0.6e-3


def test_withheld_points_are_no_measurements(tmp_path):
    withheld = np.arange(700) % 7 == 0
    path = write_las(tmp_path / "s.las", SCAN.points, withheld=withheld.astype(np.uint8))
    np.testing.assert_array_equal(np.isnan(read_scan(path).points).all(axis=1), withheld)


def test_columns_have_all_dimensions_in_the_coordinates_of_the_file(tmp_path):
    classes = (np.arange(700) % 20).astype(np.uint8)
    points = SCAN.points + np.array(UTM)
    path = write_las(tmp_path / "s.laz", points, offsets=(5e5, 5.4e6, 0), classification=classes)
    columns = las_columns(path)
    np.testing.assert_array_equal(columns["classification"], classes)
    np.testing.assert_allclose(
        np.column_stack([columns[axis] for axis in "xyz"]), points, atol=6e-4
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", range(11))
def test_the_classification_alone_is_that_of_all_dimensions(tmp_path, suffix, kind):
    classes = (np.arange(700) % 20).astype(np.uint8)
    path = write_las(tmp_path / f"s{suffix}", SCAN.points, kind=kind, classification=classes)
    np.testing.assert_array_equal(read_classification(path), classes)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_damaged_empty_and_other_files_are_refused(tmp_path, suffix):
    path = write_las(tmp_path / f"s{suffix}", SCAN.points, WORDS)
    content = path.read_bytes()
    for length in (len(content) // 2, len(content) - 9, 380, 300, 100, 4):
        path.write_bytes(content[:length])
        error = refused(FormatError, path, read_scan, path)
        assert "damaged or cut off" in error.value.problem, length
    for other, problem in ((b"", "is empty"), (b"ply\n" + content[4:], "is not a LAS file")):
        path.write_bytes(other)
        assert refused(FormatError, path, read_scan, path).value.problem == problem
    path.write_bytes(content[:104] + bytes([content[104] & 128 | 11]) + content[105:])
    assert refused(FormatError, path, read_scan, path).value.problem == "has point format 11"
    path.write_bytes(content[:105] + b"\5\0" + content[107:])
    refused(FormatError, path, read_scan, path)
    path.write_bytes(content[:24] + b"\1\5" + content[26:])
    assert refused(FormatError, path, read_scan, path).value.problem == "has version 1.5"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_without_points_is_a_scan_without_points(tmp_path, suffix):
    path = write_las(tmp_path / f"s{suffix}", np.zeros((0, 3)))
    assert len(read_scan(path)) == 0


def test_a_panic_of_lazrs_is_a_damaged_file(tmp_path):
    path = write_las(tmp_path / "s.laz", SCAN.points)
    with laspy.open(path) as file:
        data = file.point_source.vlr.record_data()
    path.write_bytes(path.read_bytes().replace(data, data[:32] + b"\0\0" + data[34:]))
    with pytest.raises(BaseException, match="at least one LazItem") as caught:
        laspy.read(path, laz_backend=laspy.LazBackend.Lazrs)
    assert type(caught.value).__name__ == PANIC
    with pytest.raises(FormatError, match="at least one LazItem"):
        read_scan(path)


@pytest.mark.parametrize("package", ["laspy", "lazrs"])
def test_a_missing_package_is_named_with_the_file_and_its_extra(tmp_path, monkeypatch, package):
    path = write_las(tmp_path / "drive.laz", SCAN.points)
    monkeypatch.setitem(sys.modules, package, None)
    error = refused(MissingDependency, path, read_scan, path)
    assert package in error.value.problem
    assert "[las]" in error.value.hint


def test_las_needs_no_package_that_unpacks(tmp_path, monkeypatch):
    path = write_las(tmp_path / "drive.las", SCAN.points)
    monkeypatch.setitem(sys.modules, "lazrs", None)
    assert len(read_scan(path)) == 700


@pytest.mark.real
def test_reported_files_are_named(real_data):
    folder = real_data / "data/reported/not_scans"
    with pytest.raises(FormatError, match="degrees") as caught:
        read_scan(folder / "epsg_4326.las")
    assert "EPSG:32615" in caught.value.hint
    with pytest.raises(FormatError, match=r"version 1\.5"):
        read_scan(folder / "pdrf10-1.5.laz")
