# SPDX-License-Identifier: MIT
"""The scan of each edited file."""

from pathlib import Path

import pytest

from salsanext_cli.core.errors import LabelError, NoInputError
from salsanext_cli.runs.annotation.edited_files import find_edited, scan_of_edited
from salsanext_cli.runs.scans.scan_file import ScanFile


def scans_of(*names):
    split = [name.split("/") for name in names]
    return [
        ScanFile(sequence=s, stem=stem, path=Path(f"/d/sequences/{s}/velodyne/{stem}.bin"))
        for s, stem in split
    ]


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


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("08/1_5.label", "08/1.5"),
        ("08_1_5.label", "08/1.5"),
        ("08_1.5.pcd", "08/1.5"),
        ("08/1.label", "08/1"),
        ("08_1.pcd", "08/1"),
    ],
)
def test_a_whole_name_with_lines_in_place_of_dots_comes_before_its_words(edited, name, expected):
    assert belongs(edited / name, edited, scans_of("08/1", "08/1.5")) == expected


@pytest.mark.parametrize(
    ("name", "scans"),
    [
        ("1_5.pcd", ("08/1.5", "1/5")),
        ("1_5.label", ("08/1.5", "1/1.5")),
        ("08/1_5_9.label", ("08/1.5_9", "08/1_5.9")),
        ("my 1_5.pcd", ("08/1", "08/1.5")),
        ("08_1_5.pcd", ("08/1_5", "08_1/5")),
    ],
)
def test_a_whole_name_of_several_scans_is_an_error(edited, name, scans):
    with pytest.raises(LabelError):
        belongs(edited / name, edited, scans_of(*scans))


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
