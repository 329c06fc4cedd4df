# SPDX-License-Identifier: MIT
"""One scan in every format, names that are no files, files that change while they are read."""

import errno
import gzip
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from scans import IN_BYTES, make_scan

from salsanext_cli.errors import FormatError
from salsanext_cli.files.reading import filled, is_folder, present, refusing_damage
from salsanext_cli.formats import SCAN_SUFFIXES, kitti, read_scan
from salsanext_cli.formats.kitti import read_bin, read_labels, write_bin, write_labels
from salsanext_cli.formats.npy import read_array
from salsanext_cli.formats.ply import write_ply
from salsanext_cli.records import Scan

SCAN = Scan(np.float32([[1, 2, 3], [-4.5, 0, 1e-3], [70, -80, 2]]), np.float32([0.0, 127.5, 255.0]))
TEXTS = {".csv": ",", ".xyz": " ", ".txt": "; ", ".asc": ";", ".pts": " "}
READERS = dict.fromkeys(SCAN_SUFFIXES, read_scan) | {
    ".label": read_labels,
    ".npy": lambda path: read_array(path, "float32", (None,)),
}


def write(path):
    table = np.column_stack([SCAN.points, SCAN.intensity])
    if path.suffix == ".gz":
        write(path.with_suffix(""))
        path.write_bytes(gzip.compress(path.with_suffix("").read_bytes()))
    elif path.name.endswith(".pcd.bin"):
        path.write_bytes(np.column_stack([table, np.arange(3)]).astype("<f4").tobytes())
    elif path.suffix == ".bin":
        write_bin(path, SCAN)
    elif path.suffix == ".ply":
        write_ply(path, dict(zip(("x", "y", "z", "intensity"), table.T, strict=True)))
    elif path.suffix in (".las", ".laz"):
        write_las(path, table)
    elif path.suffix == ".npy":
        np.save(path, table)
    elif path.suffix == ".npz":
        np.savez(path, points=SCAN.points, intensity=SCAN.intensity)
    elif path.suffix in TEXTS:
        mark = TEXTS[path.suffix]
        path.write_text("".join(mark.join(map(str, row)) + "\n" for row in table.tolist()))
    else:
        path.write_bytes(
            b"FIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 3\nHEIGHT 1\n"
            b"POINTS 3\nDATA binary\n" + struct.pack("<12f", *table.ravel())
        )


def write_las(path, table):
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=6)
    las.header.scales = np.full(3, 2.0**-20)
    las.x, las.y, las.z = table[:, :3].T
    # Of 16 bits, which are divided whatever the sensor says.
    las.intensity = table[:, 3] * 257
    las.write(path)


@pytest.mark.parametrize("suffix", SCAN_SUFFIXES)
def test_the_same_scan_in_every_format(tmp_path, suffix):
    lower = tmp_path / f"ein scan{suffix}"
    write(lower)
    upper = lower.rename(tmp_path / f"Übung{suffix.upper()}")
    scan = read_scan(upper, IN_BYTES)
    tolerance = 2.0**-20 if "la" in suffix else 0
    np.testing.assert_allclose(scan.points, SCAN.points, rtol=0, atol=tolerance)
    np.testing.assert_allclose(scan.intensity, np.float32([0, 0.5, 1]), rtol=0, atol=tolerance * 16)
    assert scan.points.flags.c_contiguous
    assert scan.points.flags.writeable
    assert scan.intensity.flags.writeable
    unscaled = np.float32(1 / 255 if "la" in suffix else 1)
    np.testing.assert_allclose(read_scan(upper).intensity, SCAN.intensity * unscaled, rtol=1e-4)


@pytest.mark.parametrize("name", ["s.docx", "s", "bin", "s.gz"])
def test_unknown_suffix(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(FormatError, match=r"\.bin"):
        read_scan(tmp_path / name)


@pytest.mark.parametrize("suffix", READERS)
def test_other_things_than_files_are_refused_at_once(tmp_path, suffix):
    """A reader neither waits for the writer of a pipe nor reads a device without end."""
    things = {
        "no such file": lambda path: None,
        "is a directory": Path.mkdir,
        "too many levels of symbolic links": lambda path: path.symlink_to(path.name),
        "neither a file nor a link to one": os.mkfifo,
        "file nor a link": lambda path: path.symlink_to("/dev/zero"),
    }
    for number, (message, make) in enumerate(things.items()):
        path = tmp_path / f"{number}{suffix}"
        make(path)
        with pytest.raises(FormatError, match=message):
            READERS[suffix](path)


def test_names_that_lead_nowhere(tmp_path):
    (tmp_path / "file").write_bytes(b"x")
    (tmp_path / "gone").symlink_to("nothing")
    (tmp_path / "empty").touch()
    found = {
        name: (present(tmp_path / name), filled(tmp_path / name), is_folder(tmp_path / name))
        for name in ("file", "empty", "gone", "nothing", "file/x", "")
    }
    assert found == {
        "file": (True, True, False),
        "empty": (True, False, False),
        "gone": (False, False, False),
        "nothing": (False, False, False),
        "file/x": (False, False, False),
        "": (True, True, True),
    }
    (tmp_path / "loop").symlink_to("loop")
    for name, found in {"x" * 300: "name too long", "loop": "symbolic links"}.items():
        with pytest.raises(FormatError, match=found):
            present(tmp_path / name)
    assert not is_folder(tmp_path / ("x" * 300))


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (OSError(errno.EIO, "Input/output error"), "cannot be read: input/output error"),
        (OSError("Invalid data"), "damaged or cut off: Invalid data"),
    ],
)
def test_what_the_system_refuses_is_no_damage(tmp_path, error, found):
    with pytest.raises(FormatError, match=found), refusing_damage(tmp_path, "a file"):
        raise error


@pytest.mark.parametrize(("name", "read"), [("a.bin", read_bin), ("a.label", read_labels)])
def test_shorter_while_it_is_read(tmp_path, monkeypatch, name, read):
    """A program that writes the file anew makes it short for a moment."""
    write_bin(tmp_path / "a.bin", make_scan(10))
    write_labels(tmp_path / "a.label", np.zeros(10, np.uint32))
    monkeypatch.setattr(kitti, "size_of", lambda file: 16 + os.fstat(file.fileno()).st_size)
    with pytest.raises(FormatError, match="changed while it was read"):
        read(tmp_path / name)
