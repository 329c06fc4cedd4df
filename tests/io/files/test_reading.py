# SPDX-License-Identifier: MIT
"""Paths that are not files, and files that change while they are read."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from scans import make_scan, write_bin

from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.files.reading import filled, is_folder, present, refusing_damage
from salsanext_cli.io.formats import SCAN_SUFFIXES, kitti, kitti_labels, read_scan
from salsanext_cli.io.formats.kitti import read_bin
from salsanext_cli.io.formats.kitti_labels import read_labels, write_labels
from salsanext_cli.io.formats.npy import read_array

READERS = dict.fromkeys(SCAN_SUFFIXES, read_scan) | {
    ".label": read_labels,
    ".npy": lambda path: read_array(path, "float32", (None,)),
}


@pytest.mark.parametrize("name", ["s.docx", "s", "bin", "s.gz"])
def test_unknown_suffix(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(FormatError, match=r"\.bin"):
        read_scan(tmp_path / name)


@pytest.mark.parametrize("suffix", READERS)
def test_other_things_than_files_are_refused_at_once(tmp_path, suffix):
    """A reader must neither block at a pipe nor read a device without end."""
    things = {
        "no such file": lambda path: None,
        "is a directory": Path.mkdir,
        "too many levels of symbolic links": lambda path: path.symlink_to(path.name),
        "not a regular file": os.mkfifo,
        "regular file": lambda path: path.symlink_to("/dev/zero"),
    }
    for number, (problem, make) in enumerate(things.items()):
        path = tmp_path / f"{number}{suffix}"
        make(path)
        with pytest.raises(FormatError, match=problem):
            READERS[suffix](path)


def test_paths_that_lead_nowhere(tmp_path):
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
    for name, problem in {"x" * 300: "name too long", "loop": "symbolic links"}.items():
        with pytest.raises(FormatError, match=problem):
            present(tmp_path / name)
    assert not is_folder(tmp_path / ("x" * 300))


def test_errors_of_the_system_are_not_damage(tmp_path):
    for error, problem in (
        (OSError(errno.EIO, "Input/output error"), "cannot be read: input/output error"),
        (OSError("Invalid data"), "damaged or cut off: Invalid data"),
    ):
        with pytest.raises(FormatError, match=problem), refusing_damage(tmp_path, "a file"):
            raise error


def test_a_panic_of_a_library_in_rust_is_damage(tmp_path):
    panic = type("PanicException", (BaseException,), {})  # As PyO3 defines it
    with pytest.raises(FormatError, match="no item"), refusing_damage(tmp_path, "a file"):
        raise panic("no item")
    with pytest.raises(KeyboardInterrupt), refusing_damage(tmp_path, "a file"):
        raise KeyboardInterrupt


@pytest.mark.parametrize(("name", "read"), [("a.bin", read_bin), ("a.label", read_labels)])
def test_shorter_while_it_is_read(tmp_path, monkeypatch, name, read):
    """A program that rewrites the file truncates it for a moment."""
    write_bin(tmp_path / "a.bin", make_scan(10))
    write_labels(tmp_path / "a.label", np.zeros(10, np.uint32))
    for module in (kitti, kitti_labels):
        monkeypatch.setattr(module, "size_of", lambda file: 16 + os.fstat(file.fileno()).st_size)
    with pytest.raises(FormatError, match="changed while it was read"):
        read(tmp_path / name)
