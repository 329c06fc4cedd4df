# SPDX-License-Identifier: MIT
import struct

import numpy as np
import pytest

from salsanext_cli.errors import FormatError
from salsanext_cli.formats import SCAN_SUFFIXES, read_scan
from salsanext_cli.records import Scan
from salsanext_cli.storage.point_files import write_bin, write_ply

SCAN = Scan(np.float32([[1, 2, 3], [-4.5, 0, 1e-3], [70, -80, 2]]), np.float32([0.0, 127.5, 255.0]))


def write(path):
    table = np.column_stack([SCAN.points, SCAN.intensity])
    if path.name.endswith(".pcd.bin"):
        path.write_bytes(np.column_stack([table, np.arange(3)]).astype("<f4").tobytes())
    elif path.suffix == ".bin":
        write_bin(path, SCAN)
    elif path.suffix == ".ply":
        write_ply(path, dict(zip(("x", "y", "z", "intensity"), table.T, strict=True)))
    else:
        path.write_bytes(
            b"FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 3\nHEIGHT 1\n"
            b"POINTS 3\nDATA binary\n" + struct.pack("<12f", *table.ravel())
        )


@pytest.mark.parametrize("suffix", SCAN_SUFFIXES)
def test_the_same_scan_in_every_format(tmp_path, suffix):
    lower = tmp_path / f"ein scan{suffix}"
    write(lower)
    upper = lower.rename(tmp_path / f"Übung{suffix.upper()}")
    scan = read_scan(upper, intensity_scale=255)
    np.testing.assert_array_equal(scan.points, SCAN.points)
    np.testing.assert_array_equal(scan.intensity, np.float32([0, 0.5, 1]))
    assert scan.points.flags.c_contiguous
    assert scan.points.flags.writeable
    assert scan.intensity.flags.writeable
    np.testing.assert_array_equal(read_scan(upper).intensity, SCAN.intensity)


@pytest.mark.parametrize("name", ["s.txt", "s", "bin", "s.bin.gz"])
def test_unknown_suffix(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(FormatError, match=r"\.bin"):
        read_scan(tmp_path / name)
