# SPDX-License-Identifier: MIT
"""Files without header: points in any number of columns, and what cannot be points."""

import gzip
import io

import numpy as np
import pytest
from scans import make_scan

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.kitti import encode_bin, read_bin

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
    "text": (LINES[: len(LINES) // 16 * 16], r"is text .* rename it to \.csv"),
    "a short text": ("Grüße aus Köln!\n".encode() * 16, "is text"),
    "ply": (b"ply\nformat binary_little_endian 1.0\n" + bytes(16 * 99), r"is a \.ply file"),
    "npy": (npy(TABLE), r"is a \.npy file"),
    "gzip": (gzip.compress(encode_bin(SCAN)), r"is a \.bin\.gz file"),
    "float64": (TABLE.astype("<f8").tobytes(), "holds float64"),
    "float64, decimals": (TABLE.astype("<f8").round(3).tobytes(), "holds float64"),
    "float64, dyadic": (np.rint(TABLE.astype("<f8") * 128) / 128, "holds float64"),
    "float64, five columns": (np.hstack([TABLE, RING]).astype("<f8").tobytes(), "holds float64"),
    "millimetres as int32": ((TABLE * 1000).astype("<i4").tobytes(), "no coordinates in metres"),
    "big endian": (TABLE.astype(">f4").tobytes(), "no coordinates in metres"),
    "random": (np.random.default_rng(0).bytes(48_000), "no coordinates in metres"),
}


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("columns", [(), ("x", "y", "z", "intensity")])
def test_what_cannot_be_points(tmp_path, name, columns):
    content, message = OTHERS[name]
    path = tmp_path / "s.bin"
    path.write_bytes(content if isinstance(content, bytes) else content.tobytes())
    with pytest.raises(FormatError, match=message) as caught:
        read_bin(path, columns=columns)
    assert "\n" not in str(caught.value)


UNUSUAL = {
    "nothing measured": np.zeros((500, 4)),
    "two thirds zeros": np.where(np.random.default_rng(1).random((3000, 1)) < 2 / 3, 0, TABLE),
    "one plane": TABLE * [1, 1, 0, 1],
    "millimetres": TABLE * 1000,
    "UTM": TABLE + [5e5, 5.6e6, 0, 0],
    "one point": TABLE[:1],
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_what_may_be_points_is_read(tmp_path, name):
    path = tmp_path / "s.bin"
    table = UNUSUAL[name].astype("<f4")
    path.write_bytes(table.tobytes())
    np.testing.assert_array_equal(read_bin(path).points, table[:, :3])


def test_any_columns(tmp_path):
    path = tmp_path / "s.bin"
    table = np.hstack([RING, TABLE[:, 3:] * 255, TABLE[:, :3], -TABLE[:, :2]]).astype("<f4")
    path.write_bytes(table.tobytes())
    names = ("ring", "intensity", "x", "y", "z", "_", "_")
    scan = read_bin(path, columns=names, intensity_scale=255)
    np.testing.assert_array_equal(scan.points, SCAN.points)
    np.testing.assert_allclose(scan.intensity, SCAN.intensity, rtol=1e-6)
    with pytest.raises(FormatError, match=r"holds 7 columns · expected 9 float32 per point · name"):
        read_bin(path, columns=(*names, "_", "_"))
    path.write_bytes(table.tobytes()[:-4])
    with pytest.raises(FormatError, match=r"83996 bytes · expected a multiple of 28 \(7 float32"):
        read_bin(path, columns=names)
    path.write_bytes(SCAN.points.tobytes())
    assert not read_bin(path, columns=("x", "y", "z")).intensity.any()
