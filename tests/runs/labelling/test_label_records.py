# SPDX-License-Identifier: MIT
"""Files of labelling tools, and the records of their labels."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scans import write_sequence

from salsanext_cli.core.errors import LabelError, NoInputError, OutputError
from salsanext_cli.io.formats.kitti import encode_labels
from salsanext_cli.runs.labelling import label_records
from salsanext_cli.runs.labelling.edited_files import find_edited, scan_of_edited
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import ScanFile, find_scans

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
    (root / label_records.PICKED).write_text(json.dumps({"stage": "pick", request.param: digests}))
    return root


def imported(*files, scan="00/000000"):
    return label_records.ImportedScan(scan, files, 1500, 1500, 0, 0, 0, 0, "label")


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
        (data / label_records.PICKED).write_text(content)
        assert pre_labelled(data) == []


def scans_of(*names):
    split = [name.split("/") for name in names]
    return [ScanFile(s, stem, Path(f"/d/sequences/{s}/velodyne/{stem}.bin")) for s, stem in split]


SCANS = scans_of("00/000010", "00/000100", "08/000010", "08/000011", "x/scan 1", "x/scan 1 b")


@pytest.fixture
def edited(tmp_path):
    return tmp_path / "edited"


def belongs(path, top, scans=SCANS):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    found = scan_of_edited(path, top, scans)
    return found.name


def test_names_and_folders_determine_the_scan(edited):
    for name, expected in (
        ("000011 - Cloud.ply", "08/000011"),
        ("000011_edited.PLY", "08/000011"),
        ("my-000100.segmented.pcd", "00/000100"),
        ("00/000010.label", "00/000010"),
        ("08/000010.label", "08/000010"),
        ("a/sequences/08/b/c/000010.label", "08/000010"),
        ("08_000010.ply", "08/000010"),
        ("000010 (00).ply", "00/000010"),
        ("scan 1 b.ply", "x/scan 1 b"),
        ("x/scan 1.ply", "x/scan 1"),
    ):
        assert belongs(edited / name, edited) == expected


def test_a_name_of_no_scan_or_several_is_an_error(edited):
    for name, scans in (
        ("000010.ply", "00/000010, 08/000010"),
        ("1000011.ply", "no scan"),
        ("00/000011.ply", "no scan in sequence 00"),
        ("sequences/05/000011.label", "no scan in sequence 05"),
        ("scan 1 b edited.ply", "x/scan 1, x/scan 1 b"),
    ):
        with pytest.raises(LabelError) as caught:
            belongs(edited / name, edited)
        assert caught.value.problem.endswith(scans)


def test_the_named_folder_may_be_a_sequence_and_one_file_of_one_scan_needs_no_name(edited):
    for top in (edited / "08", edited / "sequences/08/labels"):
        assert belongs(top / "000010.label", top) == "08/000010"
    # Folders above it do not count, unless they are in `sequences`.
    with pytest.raises(LabelError, match="00/000010, 08/000010"):
        belongs(edited / "08/clouds/000010.ply", edited / "08/clouds")
    assert belongs(edited / "any.ply", edited / "any.ply", SCANS[:1]) == "00/000010"
    with pytest.raises(LabelError, match="no scan"):
        belongs(edited / "any.ply", edited, SCANS[:1])
    with pytest.raises(LabelError, match="no scan"):
        belongs(edited / "any.ply", edited / "any.ply", SCANS[:2])


def test_files_with_labels_are_found_in_order(tmp_path, monkeypatch):
    for name in ("b/2.ply", "b/1.PCD", "a.npy", ".hidden.ply", ".x/1.ply", "1.bin", "c.label"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    expected = [tmp_path / name for name in ("a.npy", "b/1.PCD", "b/2.ply", "c.label")]
    assert find_edited(tmp_path) == expected
    monkeypatch.chdir(tmp_path)
    assert find_edited(Path()) == expected
    assert find_edited(Path("b/2.ply")) == [tmp_path / "b/2.ply"]


def test_nothing_to_import_is_an_error(tmp_path):
    (tmp_path / "1.bin").touch()
    (tmp_path / "none").touch()
    for name, problem in {
        "": "1 without a suffix, 1 .bin",
        "1.bin": "a .bin file",
        "none": "no suffix",
        "absent.ply": "no such file",
    }.items():
        with pytest.raises(NoInputError) as caught:
            find_edited(tmp_path / name)
        assert problem in caught.value.problem
