# SPDX-License-Identifier: MIT
"""Scans of files, folders and data sets, and their selection."""

from pathlib import Path

import pytest
from scans import refused

from salsanext_cli.core.errors import NoInputError, OutputError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.annotation.edited_files import find_edited
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import select_scans


def make(folder: Path, *names: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"")


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """Make two sequences with equal file names, and other files and folders."""
    root = tmp_path / "Straße 1"
    for sequence in ("08", "00"):
        make(root / "sequences" / sequence / "velodyne", "000001.bin", "000000.bin")
        make(root / "sequences" / sequence / "labels", "000000.label")
        make(root / "sequences" / sequence, "poses.txt", "calib.txt")
    make(root / "sequences" / "08" / "velodyne", ".000002.bin", "notes.txt", "000000.npy")
    make(root / "sequences" / "08" / "velodyne" / "000009.bin")
    make(root / "sequences" / "empty" / "velodyne")
    make(root / "sequences" / ".hidden" / "velodyne", "000000.bin")
    make(root / "sequences", "readme.txt")
    return root


BOTH = [("00", "000000"), ("00", "000001"), ("08", "000000"), ("08", "000001")]


def test_every_way_to_name_scans(dataset) -> None:
    for place, expected in (
        (".", BOTH),
        ("sequences", BOTH),
        ("sequences/08", BOTH[2:]),
        ("sequences/08/velodyne", BOTH[2:]),
        ("sequences/08/velodyne/000001.bin", BOTH[3:]),
        ("sequences/../sequences/08", BOTH[2:]),
    ):
        scans = find_scans(dataset / place)
        assert [(scan.sequence, scan.stem) for scan in scans] == expected
        for scan in scans:
            folder = dataset / "sequences" / scan.sequence
            assert scan.path == folder / "velodyne" / f"{scan.stem}.bin"
            assert scan.label_path == folder / "labels" / f"{scan.stem}.label"


@pytest.mark.parametrize("place", [".", "..", "../velodyne", "./000000.bin", "../../08/velodyne"])
def test_relative_places_get_their_true_names(dataset, place, monkeypatch) -> None:
    monkeypatch.chdir(dataset / "sequences" / "08" / "velodyne")
    scan = find_scans(Path(place))[0]
    assert (scan.sequence, scan.stem) == ("08", "000000")
    assert scan.path.is_absolute()


def test_links_have_their_names_and_may_point_nowhere(dataset, tmp_path) -> None:
    link = tmp_path / "drive"
    link.symlink_to(dataset / "sequences" / "08" / "velodyne")
    assert {(scan.sequence, scan.path.parent) for scan in find_scans(link)} == {("drive", link)}
    make(tmp_path / "scans", "a.bin")
    (tmp_path / "scans" / "b.bin").symlink_to(tmp_path / "gone.bin")
    assert [scan.stem for scan in find_scans(tmp_path / "scans")] == ["a", "b"]


def test_plain_folder_and_its_labels(tmp_path: Path) -> None:
    folder = tmp_path / "Fahrt 1 äöü"
    make(folder, "b.PLY", "a.Pcd", "n__LIDAR_TOP__15.331.pcd.bin", "c.x.BIN", "c.txt")
    scans = find_scans(folder)
    assert [scan.stem for scan in scans] == ["a", "b", "c.x", "n__LIDAR_TOP__15.331"]
    assert {scan.sequence for scan in scans} == {"Fahrt 1 äöü"}
    assert scans[2].label_path == folder / "c.x.label"
    make(folder / "labels", "c.x.label")
    assert scans[2].label_path == folder / "labels" / "c.x.label"
    assert scans[0].label_path == folder / "a.label"


@pytest.mark.parametrize(
    ("names", "expected"),
    [(["8"], ["08"]), (["008"], ["08"]), (["0", "8", "08"], ["00", "08"]), ([], [])],
)
def test_sequences_are_chosen_by_name_or_number(dataset, names, expected) -> None:
    assert sorted({scan.sequence for scan in find_scans(dataset, names)}) == expected


@pytest.mark.parametrize("name", ["9", "8.0", "-8", "x", "", "empty", ".hidden", "../08"])
def test_a_missing_sequence_is_refused(dataset: Path, name: str) -> None:
    refused(NoInputError, dataset, find_scans, dataset, ["08", name])


def test_exact_name_wins_over_number_and_text_beside_sequences_is_no_scan(tmp_path: Path) -> None:
    make(tmp_path, "readme.txt")
    for sequence in ("8", "08"):
        make(tmp_path / sequence / "velodyne", "0.bin")
    assert [scan.sequence for scan in find_scans(tmp_path, ["8"])] == ["8"]
    assert [scan.sequence for scan in find_scans(tmp_path, ["008"])] == ["08", "8"]


@pytest.mark.parametrize(
    "source", ["folder", "folder/notes.md", "missing", "folder/notes.md/deeper"]
)
def test_sources_without_scans_are_refused(tmp_path: Path, source: str) -> None:
    make(tmp_path / "folder", "notes.md", ".hidden.bin")
    refused(NoInputError, tmp_path / source, find_scans, tmp_path / source)


def test_labels_in_place_of_scans_are_answered_by_the_folder_of_the_scans(
    dataset: Path, monkeypatch
) -> None:
    sequence = dataset / "sequences/00"
    monkeypatch.chdir(sequence)
    for source in (Path("labels"), Path("labels/000000.label")):
        hint = refused(NoInputError, source, find_scans, source).value.hint
        assert hint == "labels are no scans: give velodyne"
        assert len(find_scans(Path("velodyne"))) == 2
    monkeypatch.chdir(sequence / "labels")
    hint = refused(NoInputError, ".", find_scans, Path()).value.hint
    assert hint.endswith(" give ../velodyne")
    (sequence / "velodyne").rename(sequence / "clouds")
    hint = refused(NoInputError, ".", find_scans, Path()).value.hint
    assert hint.endswith(" give the folder of the scans")


@pytest.mark.parametrize("name", ["s.las", "S.LAZ"])
def test_files_of_las_are_scans_and_contain_labels(tmp_path: Path, name) -> None:
    make(tmp_path, name)
    assert [scan.path.name for scan in find_scans(tmp_path)] == [name]
    assert find_edited(tmp_path) == [tmp_path / name]


@pytest.mark.parametrize(
    ("names", "scans"),
    [
        (["a.bin", "b.ply", "c.npy", "d.csv", "notes.txt"], ["a", "b"]),
        (["c.npy", "d.csv", "notes.txt"], ["c"]),
        (["d.npz", "d.csv", "notes.txt"], ["d"]),
        (["d.csv", "notes.txt"], ["d"]),
        (["e.TXT", "f.txt", "g.jpg"], ["e", "f"]),
    ],
)
def test_tables_are_scans_where_there_are_no_clouds(tmp_path: Path, names, scans) -> None:
    make(tmp_path, *names)
    assert [scan.stem for scan in find_scans(tmp_path)] == scans
    for name in names[:1]:
        assert [scan.path.name for scan in find_scans(tmp_path / name)] == [name]


@pytest.mark.parametrize("name", ["scores.txt", "log.csv", "picked.csv"])
def test_our_tables_are_scans_only_if_they_are_named(tmp_path: Path, name, caplog) -> None:
    suffix = Path(name).suffix
    make(tmp_path, f"a{suffix}", name)
    assert [scan.path.name for scan in find_scans(tmp_path / name)] == [name]
    with caplog.at_level(NOTICE):
        scans = select_scans(tmp_path, ScanSelection())
    assert [scan.path.name for scan in scans] == [f"a{suffix}"]
    assert caplog.messages == [f"{tmp_path}: skipped 1 {suffix}"]


def test_other_files_are_counted_once(tmp_path: Path, caplog) -> None:
    make(tmp_path, "a.bin", "b.bin", "a.label", "notes.txt", "x.JPG", "y.jpg", "README", ".z.jpg")
    make(tmp_path / "labels", "a.label")
    with caplog.at_level("INFO"):
        assert len(select_scans(tmp_path, ScanSelection())) == 2
    (notice,) = caplog.records
    assert notice.levelno == NOTICE
    assert notice.getMessage() == f"{tmp_path}: skipped 1 without a suffix, 2 .jpg, 1 .txt"
    caplog.clear()
    select_scans(tmp_path / "a.bin", ScanSelection())
    assert not caplog.records


def test_two_scans_of_one_stem_are_refused(tmp_path: Path) -> None:
    make(tmp_path, "000000.bin", "000000.pcd", "000001.bin")
    refused(OutputError, f"{tmp_path.name}/000000", find_scans, tmp_path)
