# SPDX-License-Identifier: MIT
"""Files of labelling tools, and the scans that they belong to."""

from pathlib import Path

import pytest

from salsanext_cli.errors import LabelError, NoInputError
from salsanext_cli.labelling.edited_files import find_edited, scan_of_edited
from salsanext_cli.results.layout import ScanFile


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
    return f"{found.sequence}/{found.stem}"


def test_names_and_folders_tell_the_scan(edited):
    for name, expected in (
        ("000011 - Cloud.ply", "08/000011"),
        ("000011_edited.PLY", "08/000011"),
        ("my-000100.segmented.las", "00/000100"),
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
    for name, found in (
        ("000010.ply", "may belong to 00/000010, 08/000010 · expected"),
        ("1000011.ply", "belongs to no scan · expected"),
        ("00/000011.ply", "belongs to no scan in sequence 00 ·"),
        ("sequences/05/000011.label", "belongs to no scan in sequence 05 ·"),
        ("scan 1 b edited.ply", "may belong to x/scan 1, x/scan 1 b ·"),
    ):
        with pytest.raises(LabelError) as caught:
            belongs(edited / name, edited)
        assert found in str(caught.value)


def test_the_folder_that_is_named_may_be_that_of_a_sequence(edited):
    for top in (edited / "08", edited / "sequences/08/labels"):
        assert belongs(top / "000010.label", top) == "08/000010"
    # What lies above it says nothing, unless it is in `sequences`.
    with pytest.raises(LabelError, match="may belong"):
        belongs(edited / "08/clouds/000010.ply", edited / "08/clouds")


def test_one_file_and_one_scan_need_no_names(edited):
    assert belongs(edited / "any.ply", edited / "any.ply", SCANS[:1]) == "00/000010"
    with pytest.raises(LabelError, match="no scan"):
        belongs(edited / "any.ply", edited, SCANS[:1])
    with pytest.raises(LabelError, match="no scan"):
        belongs(edited / "any.ply", edited / "any.ply", SCANS[:2])


def test_files_with_labels_are_found_in_order(tmp_path, monkeypatch):
    for name in ("b/2.ply", "b/1.LAZ", "a.npy", ".hidden.ply", ".x/1.ply", "1.bin", "c.label"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    expected = [tmp_path / name for name in ("a.npy", "b/1.LAZ", "b/2.ply", "c.label")]
    assert find_edited(tmp_path) == expected
    monkeypatch.chdir(tmp_path)
    assert find_edited(Path()) == expected
    assert find_edited(Path("b/2.ply")) == [tmp_path / "b/2.ply"]


def test_nothing_to_import_is_an_error(tmp_path):
    (tmp_path / "1.bin").touch()
    (tmp_path / "none").touch()
    for name, found in {
        "": "holds no labels, but 1 without a suffix, 1 .bin · expected labels: .ply, .pcd",
        "1.bin": "a .bin file",
        "none": "has no suffix",
        "absent.ply": "no such file or folder",
    }.items():
        with pytest.raises(NoInputError) as caught:
            find_edited(tmp_path / name)
        assert found in str(caught.value)
