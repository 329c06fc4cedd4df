# SPDX-License-Identifier: MIT
"""Files of labelling tools, and the records of their labels."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scans import write_sequence

from salsanext_cli.core.errors import OutputError
from salsanext_cli.io.formats.kitti_labels import encode_labels
from salsanext_cli.runs.annotation import label_records
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_search import find_scans

PRE_LABEL = encode_labels(np.full(1500, 40, np.uint32))


@pytest.fixture(params=label_records.PRE_LABELS)
def data(tmp_path, request):
    """Return a data set whose two scans of sequence 00 have pre-labels, and one has labels."""
    root = tmp_path / "data"
    write_sequence(root / "sequences/00", ["000000", "000001"], labels=False)
    write_sequence(root / "sequences/01", ["000000"])
    for scan in find_scans(root)[:2]:
        OwnedFolder(root).write(scan.label_path, PRE_LABEL)
    digests = dict.fromkeys(("00/000000", "00/000001"), hashlib.sha256(PRE_LABEL).hexdigest())
    (root / label_records.PICK_RECORD).write_text(
        json.dumps({"stage": "pick", request.param: digests})
    )
    return root


def imported(*files, scan="00/000000"):
    return label_records.ImportedScan(
        scan=scan,
        files=files,
        points=1500,
        labelled=1500,
        unlabelled=0,
        ambiguous=0,
        missing=0,
        unmatched=0,
        scalar="label",
    )


A, B = Path("edited/a.ply"), Path("edited/b.ply")


def pre_labelled(root):
    return [scan.name for scan in label_records.pre_labelled_scans(find_scans(root))]


def test_labels_are_pre_labels_until_they_are_changed_or_imported(data):
    assert pre_labelled(data) == ["00/000000", "00/000001"]
    first, second, other = find_scans(data)
    records = label_records.LabelRecords(data)
    replaceable = [records.is_replaceable(scan, A) for scan in (first, second, other)]
    assert replaceable == [True, True, False]
    records.write(first, PRE_LABEL, imported("a.ply"))
    assert pre_labelled(data) == ["00/000001"]
    second.label_path.write_bytes(PRE_LABEL[4:] + PRE_LABEL[:3] + b"\1")
    assert pre_labelled(data) == []
    assert label_records.LabelRecords(data).is_replaceable(first, A)
    # Another file may contain other points of the scan.
    assert not label_records.LabelRecords(data).is_replaceable(first, B)
    assert not label_records.LabelRecords(data).is_replaceable(second, A)
    (line,) = filter(None, (data / label_records.IMPORTED[1]).read_text().splitlines())
    assert json.loads(line)["files"] == ["a.ply"]
    # Older versions merged several files.
    records.write(first, PRE_LABEL, imported("a.ply", "b.ply"))
    assert not label_records.LabelRecords(data).is_replaceable(first, A)


def test_a_copy_of_a_data_set_has_its_pre_labels(data, tmp_path):
    # Without times of modification, which identify written files.
    copy = shutil.copytree(data, tmp_path / "copy", copy_function=shutil.copyfile)
    assert pre_labelled(copy) == ["00/000000", "00/000001"]
    assert label_records.LabelRecords(copy).is_replaceable(find_scans(copy)[0], A)
    assert not label_records.LabelRecords(copy).is_replaceable(find_scans(copy)[2], A)


def test_an_interrupted_import_leaves_a_pre_label(data, monkeypatch):
    scan = find_scans(data)[0]
    write = OwnedFolder.write

    def refuse(self, path, content, **options):
        if path == scan.label_path:
            raise OutputError(path, "no space left")
        write(self, path, content, **options)

    monkeypatch.setattr(OwnedFolder, "write", refuse)
    with pytest.raises(OutputError):
        label_records.LabelRecords(data).write(scan, PRE_LABEL[:-4] + bytes(4), imported("a.ply"))
    assert pre_labelled(data) == ["00/000000", "00/000001"]


def test_a_line_that_was_cut_off_costs_one_import(data):
    first, second, _ = find_scans(data)
    for scan in (first, second):
        label_records.LabelRecords(data).write(scan, PRE_LABEL, imported("a.ply", scan=scan.name))
    assert pre_labelled(data) == []
    lines = data / label_records.IMPORTED[1]
    lines.write_bytes(lines.read_bytes()[:-20])
    assert pre_labelled(data) == ["00/000001"]
    label_records.LabelRecords(data).write(second, PRE_LABEL, imported("a.ply", scan=second.name))
    assert pre_labelled(data) == []


def test_imports_by_older_versions_count(data):
    first, second, _ = find_scans(data)
    known = {"sha256": hashlib.sha256(PRE_LABEL).hexdigest(), "files": ["a.ply"], "contradicted": 2}
    content = json.dumps({"scans": {first.name: known, second.name: 5}})
    (data / label_records.IMPORTED[0]).write_text(content)
    assert pre_labelled(data) == ["00/000001"]
    records = label_records.LabelRecords(data)
    assert [records.is_replaceable(scan, A) for scan in (first, second)] == [True, False]


def test_the_record_grows_by_the_scans_of_an_import(data):
    """Not by all scans that were imported before."""
    sizes, records = [0], label_records.LabelRecords(data)
    scan = find_scans(data)[0]
    for _ in range(3):
        records.write(scan, PRE_LABEL, imported("a.ply"))
        sizes.append((data / label_records.IMPORTED[1]).stat().st_size)
    assert len(set(np.diff(sizes))) == 1


def test_records_lie_above_scans_and_labels(tmp_path):
    write_sequence(tmp_path / "data/sequences/00")
    write_sequence(tmp_path / "drive")
    (tmp_path / "plain").mkdir()
    shutil.copy(tmp_path / "drive/velodyne/000000.bin", tmp_path / "plain")
    for name in ("data", "drive", "plain"):
        (scan,) = find_scans(tmp_path / name)
        assert label_records.labels_root(scan) == tmp_path / name
        assert scan.label_path.is_relative_to(label_records.labels_root(scan))


def test_a_record_of_another_kind_has_no_pre_labels(data):
    for content in ('{"guesses": [1]}', '{"guesses": {"00/000000": 5}}'):
        (data / label_records.PICK_RECORD).write_text(content)
        assert pre_labelled(data) == []
