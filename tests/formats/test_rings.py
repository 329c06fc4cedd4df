# SPDX-License-Identifier: MIT
"""Numbers of beams in point files."""

from dataclasses import replace

import numpy as np
import pytest
from scans import SMALL

from salsanext_cli import Scan, read_scan
from salsanext_cli.formats.columns import MAX_RING, ring_of, scan_of

POINTS = np.arange(24, dtype=np.float32).reshape(8, 3) + 1
RINGS = np.array([5, 3, 3, 0, 31, 1, 0, 2], np.int32)


def pcd(path, width, height, ring=False):
    """Write the points as a PCD file and read it."""
    more = (" ring", " 2", " U") if ring else ("", "", "")
    header = "FIELDS x y z{}\nSIZE 4 4 4{}\nTYPE F F F{}\n".format(*more)
    size = f"WIDTH {width}\nHEIGHT {height}\nPOINTS {len(POINTS)}\nDATA ascii\n"
    table = np.column_stack([POINTS, RINGS])[:, : 4 if ring else 3].astype(int)
    path.write_text(header + size + "\n".join(" ".join(map(str, row)) for row in table))
    return read_scan(path)


def test_a_column_is_read_else_rows_of_organised_clouds(tmp_path):
    np.testing.assert_array_equal(pcd(tmp_path / "a.pcd", 8, 1, ring=True).ring, RINGS)
    np.testing.assert_array_equal(pcd(tmp_path / "b.pcd", 4, 2, ring=True).ring, RINGS)
    table = np.column_stack([POINTS, np.zeros(8), RINGS]).astype("<f4")
    (tmp_path / "c.pcd.bin").write_bytes(table.tobytes())
    np.testing.assert_array_equal(read_scan(tmp_path / "c.pcd.bin").ring, RINGS)
    np.save(tmp_path / "d.npy", table)
    assert read_scan(tmp_path / "d.npy").ring is None
    seen = replace(SMALL, columns=("x", "y", "z", "intensity", "ring"))
    np.testing.assert_array_equal(read_scan(tmp_path / "d.npy", seen).ring, RINGS)
    assert pcd(tmp_path / "a.pcd", 8, 1).ring is None
    np.testing.assert_array_equal(pcd(tmp_path / "b.pcd", 2, 4).ring, np.repeat(np.arange(4), 2))


def test_impossible_rings_are_not_known():
    values = np.array([0, MAX_RING, MAX_RING + 1, -1, np.nan, np.inf, 1e30, 2.0])
    np.testing.assert_array_equal(ring_of(values), [0, MAX_RING, -1, -1, -1, -1, -1, 2])
    assert ring_of(np.array([0, 255], np.uint8)).dtype == np.int32
    largest = np.array([2**64 - 1, 7], np.uint64)
    np.testing.assert_array_equal(ring_of(largest), [-1, 7])


def test_points_chosen_keep_their_rings(tmp_path):
    columns = dict(zip("xyz", POINTS.T, strict=True)) | {"Ring": RINGS.astype(np.uint16)}
    scan = scan_of(columns, tmp_path / "x", 1.0)
    chosen = scan.take(np.array([4, 0, 7]))
    np.testing.assert_array_equal(chosen.ring, RINGS[[4, 0, 7]])
    np.testing.assert_array_equal(chosen.points, POINTS[[4, 0, 7]])
    with pytest.raises(ValueError, match="ring"):
        Scan(POINTS, scan.intensity, RINGS[:-1])
    with pytest.raises(ValueError, match="ring"):
        Scan(POINTS, scan.intensity, RINGS.astype(np.int64))
