# SPDX-License-Identifier: MIT
"""First guesses of a network, and imported labels."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scans import write_sequence

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.kitti import encode_labels
from salsanext_cli.labelling.label_records import (
    GUESSES,
    IMPORTED,
    PICKED,
    LabelRecords,
    first_guesses,
    labels_root,
)
from salsanext_cli.results.layout import find_scans
from salsanext_cli.results.owned_folder import OwnedFolder

GUESS = encode_labels(np.full(1500, 40, np.uint32))


@pytest.fixture
def data(tmp_path):
    """Return a data set whose two scans of sequence 00 have a first guess, and one has labels."""
    root = tmp_path / "data"
    write_sequence(root / "sequences/00", ["000000", "000001"], labels=False)
    write_sequence(root / "sequences/01", ["000000"])
    for scan in find_scans(root)[:2]:
        OwnedFolder(root).write(scan.label_path, GUESS)
    digest = hashlib.sha256(GUESS).hexdigest()
    guesses = {f"00/00000{i}": digest for i in range(2)}
    (root / PICKED).write_text(json.dumps({"stage": "pick", GUESSES: guesses}))
    return root


A = [Path("edited/a.ply")]
B = [Path("edited/b.ply")]


def guessed(root):
    return [f"{scan.sequence}/{scan.stem}" for scan in first_guesses(find_scans(root))]


def test_labels_are_a_first_guess_until_they_are_changed_or_imported(data):
    assert guessed(data) == ["00/000000", "00/000001"]
    first, second, other = find_scans(data)
    records = LabelRecords(data)
    assert [records.is_replaceable(scan, A) for scan in (first, second, other)] == [
        True,
        True,
        False,
    ]
    records.write(first, GUESS, {"files": ["a.ply"]})
    assert guessed(data) == ["00/000001"]
    second.label_path.write_bytes(GUESS[4:] + GUESS[:3] + b"\1")
    assert guessed(data) == []
    assert LabelRecords(data).is_replaceable(first, A)
    # Another file may hold other points of the scan.
    assert not LabelRecords(data).is_replaceable(first, B)
    assert LabelRecords(data).is_replaceable(first, A + B)
    assert not LabelRecords(data).is_replaceable(second, A)
    recorded = json.loads((data / IMPORTED).read_text())
    assert recorded["scans"]["00/000000"]["files"] == ["a.ply"]
    records.write(first, GUESS, {"files": ["a.ply", "more/a.ply"]})
    assert not LabelRecords(data).is_replaceable(first, A)


def test_a_copy_of_a_data_set_has_its_first_guesses(data, tmp_path):
    # Without times of modification, by which written files are known.
    copy = shutil.copytree(data, tmp_path / "copy", copy_function=shutil.copyfile)
    assert guessed(copy) == ["00/000000", "00/000001"]
    assert LabelRecords(copy).is_replaceable(find_scans(copy)[0], A)
    assert not LabelRecords(copy).is_replaceable(find_scans(copy)[2], A)


def test_an_import_that_was_cut_off_leaves_a_first_guess(data, monkeypatch):
    scan = find_scans(data)[0]
    write = OwnedFolder.write

    def refuse(self, path, content, **options):
        if path == scan.label_path:
            raise OutputError(path, "no space left")
        write(self, path, content, **options)

    monkeypatch.setattr(OwnedFolder, "write", refuse)
    with pytest.raises(OutputError):
        LabelRecords(data).write(scan, GUESS[:-4] + bytes(4), {})
    assert guessed(data) == ["00/000000", "00/000001"]


def test_records_lie_above_scans_and_labels(tmp_path):
    write_sequence(tmp_path / "data/sequences/00")
    write_sequence(tmp_path / "drive")
    (tmp_path / "plain").mkdir()
    shutil.copy(tmp_path / "drive/velodyne/000000.bin", tmp_path / "plain")
    for name in ("data", "drive", "plain"):
        (scan,) = find_scans(tmp_path / name)
        assert labels_root(scan) == tmp_path / name
        assert scan.label_path.is_relative_to(labels_root(scan))


def test_a_record_of_another_kind_tells_of_no_guesses(data):
    for content in ('{"guesses": [1]}', '{"guesses": {"00/000000": 5}}'):
        (data / PICKED).write_text(content)
        assert guessed(data) == []
