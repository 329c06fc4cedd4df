# SPDX-License-Identifier: MIT
"""Scans of LAS and LAZ files: their frames and their intensities."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from las_files import write_las
from scans import IN_BYTES, SMALL, make_scan

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.notices import log_once

pytest.importorskip("laspy")
pytest.importorskip("lazrs")
SUFFIXES = (".las", ".laz")
SCAN = make_scan(700)
WORDS = np.rint(SCAN.intensity * 65535).astype(np.uint16)
UTM = (500_123.4, 5_400_456.7, 312.0)


@pytest.fixture(autouse=True)
def every_notice(caplog):
    log_once.cache_clear()
    caplog.set_level(logging.INFO)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_map_coordinates_become_a_local_frame_and_a_line_says_it(tmp_path, suffix, caplog):
    points = SCAN.points + np.array(UTM)
    path = write_las(tmp_path / f"s{suffix}", points, WORDS, offsets=(5e5, 5.4e6, 0))
    scan = read_scan(path)
    assert scan.notes.frame == (500_000, 5_400_000, 0)
    assert np.abs(scan.points + np.array(scan.notes.frame) - points).max() < 0.8e-3
    read_scan(path)
    lines = [line for line in caplog.messages if "map coordinates" in line]
    assert len(lines) == 1
    assert "500000 m" in lines[0]
    assert "5400000 m" in lines[0]


def test_intensities_of_bytes_and_a_stated_scale(tmp_path, caplog):
    values = np.rint(SCAN.intensity * 255).astype(np.uint16)
    path = write_las(tmp_path / "s.las", SCAN.points, values)
    np.testing.assert_array_equal(read_scan(path).intensity, values / np.float32(255))
    assert sum("as bytes" in line for line in caplog.messages) == 1
    path = write_las(tmp_path / "other/t.las", SCAN.points, values * 16)
    np.testing.assert_array_equal(read_scan(path).intensity, values * 16 / np.float32(65535))
    stated = replace(SMALL, intensity_scale=4080.0)
    np.testing.assert_allclose(read_scan(path, stated).intensity, values / 255, rtol=1e-6)
    np.testing.assert_allclose(read_scan(path, IN_BYTES).intensity, values * 16 / 255, rtol=1e-6)


def test_another_field_may_be_the_intensity(tmp_path):
    amplitude = np.arange(700, dtype=np.float32)
    path = write_las(tmp_path / "s.laz", SCAN.points, WORDS, extra={"amplitude": amplitude})
    sensor = replace(SMALL, intensity_field="amplitude")
    np.testing.assert_array_equal(read_scan(path, sensor).intensity, amplitude)
    with pytest.raises(FormatError, match="no single field echo"):
        read_scan(path, replace(SMALL, intensity_field="echo"))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_dim_scan_of_a_folder_has_the_range_of_the_others(tmp_path, suffix, caplog):
    dim = WORDS % 200
    path = write_las(tmp_path / f"a{suffix}", SCAN.points, dim)
    np.testing.assert_array_equal(read_scan(path).intensity, dim / np.float32(255))
    write_las(tmp_path / "b.las", SCAN.points, WORDS)
    (tmp_path / "c.las").write_bytes(b"damaged")
    np.testing.assert_array_equal(read_scan(path).intensity, dim / np.float32(65535))
    assert sum("as 16 bits" in line for line in caplog.messages) == 1
    # Another folder
    path = write_las(tmp_path / f"d/a{suffix}", SCAN.points, dim)
    np.testing.assert_array_equal(read_scan(path).intensity, dim / np.float32(255))


def test_stray_points_do_not_move_the_frame(tmp_path):
    points = SCAN.points + np.array(UTM)
    points[0] = 0
    points[1] = (9e5, 1e5, 1)
    scan = read_scan(write_las(tmp_path / "s.las", points, WORDS, scale=0.01))
    assert scan.notes.frame == (500_000, 5_400_000, 0)
    assert np.abs(scan.points[2:] + np.array(scan.notes.frame) - points[2:]).max() < 0.6e-2
