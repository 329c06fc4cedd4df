# SPDX-License-Identifier: MIT
"""Files that salsanext wrote are recognised; foreign files are never removed."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from scans import files_below, refused

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.errors import OutputError
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_folders import FILE_LISTS


@pytest.fixture
def written(tmp_path: Path) -> OwnedFolder:
    return OwnedFolder(tmp_path / "out")


@pytest.mark.parametrize("scans", ["[]", '{"08/0": 3}', '{"08/0": [["few"]]}'])
def test_damaged_warnings_are_refused(tmp_path: Path, scans: str) -> None:
    path = tmp_path / "predict.warnings.json"
    path.write_text(f'{{"scans": {scans}}}')
    with refused(OutputError, path):
        OwnedFolder(tmp_path, "predict").findings()


def test_warnings_are_recorded_in_order_and_replaced_by_those_of_scans_checked_again(
    tmp_path: Path,
) -> None:
    sparse = Finding(WarningCode.SPARSE, "few rows", "look")
    tilted = Finding(WarningCode.TILTED, "leans", "level it")
    folder = OwnedFolder(tmp_path, "predict")
    assert folder.record_findings({"08/1": [tilted, sparse], "08/0": [sparse]}, {"08/0"}) == {}
    # Folders of earlier versions have this form.
    rows = {"08/0": [["sparse", "few rows", "look"]]}
    rows["08/1"] = [*rows["08/0"], ["tilted", "leans", "level it"]]
    recorded = json.loads((tmp_path / "predict.warnings.json").read_text())
    assert recorded == {"stage": "predict", "scans": rows}
    assert list(recorded["scans"]) == ["08/0", "08/1"]
    assert folder.findings() == {"08/0": [sparse], "08/1": [sparse, tilted]}
    assert folder.record_findings({"08/0": [tilted]}, {"08/0"}) == {"08/1": [sparse, tilted]}
    assert folder.findings() == {"08/0": [tilted], "08/1": [sparse, tilted]}


@pytest.mark.parametrize(
    "name", ["a.label", "deep/er/ü ä.npy", "tab\tline\nend", "b\udcffad", "%41"]
)
def test_a_written_file_is_recognised(written: OwnedFolder, name: str) -> None:
    path = written.root / name
    written.write(path, b"once before")
    written.write(path, b"content")
    assert path.read_bytes() == b"content"
    assert written.foreign_files([path]) == []
    assert written.written() == [path]
    assert written.remove_written([path]) == []
    assert not path.exists()
    assert written.written() == []


def test_foreign_files_stay(written: OwnedFolder) -> None:
    """They were edited, touched, added by hand, or replaced by a link."""
    ours, *others = (written.root / name for name in ("ours", "edited", "touched", "replaced"))
    for path in (ours, *others):
        written.write(path, b"1234")
    others[0].write_bytes(b"12345")
    os.utime(others[1], ns=(0, others[1].stat().st_mtime_ns + 1))
    others[2].unlink()
    others[2].symlink_to(ours)
    foreign = written.root / "foreign"
    foreign.write_bytes(b"mine")
    assert written.foreign_files([ours, *others, foreign]) == [*others, foreign]
    assert written.remove_written([ours, *others, foreign]) == [*others, foreign]
    assert sorted(path.name for path in written.root.iterdir() if path.name[0] != ".") == [
        *("edited", "foreign", "replaced", "touched")
    ]


def test_files_behind_a_link_below_the_folder_stay(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    written, path = OwnedFolder(tmp_path / "out"), tmp_path / "out/sequences/00/a.bin"
    written.write(path, b"scan")
    assert written.foreign_files([path]) == []
    path.parent.rename(tmp_path / "elsewhere")
    path.parent.symlink_to(tmp_path / "elsewhere")
    assert written.remove_written([path]) == [path]
    assert path.read_bytes() == b"scan"


def test_an_empty_file_of_a_power_cut_is_not_foreign(written: OwnedFolder) -> None:
    written.root.mkdir()
    (written.root / "empty").touch()
    assert written.foreign_files([written.root / "empty", written.root / "none"]) == []


@pytest.fixture
def adopted(written: OwnedFolder) -> Path:
    """Return a folder of the output folder that was adopted; a later one is complete."""
    path = written.root / "drive"
    for number in range(2):
        later = written.root / ".new/drive"
        later.mkdir(parents=True)
        (later / f"drive_{number}.mcap").write_bytes(b"12345")
        (later / "metadata.yaml").write_text(f"{number}")
        if not number:
            written.adopt(later, path)
    return path


def adopt_later(written: OwnedFolder) -> None:
    written.adopt(written.root / ".new/drive", written.root / "drive")


def test_an_adopted_folder_replaces_the_earlier_one(written: OwnedFolder, adopted: Path) -> None:
    assert files_below(adopted) == {"drive_0.mcap": b"12345", "metadata.yaml": b"0"}
    adopt_later(written)
    assert files_below(adopted) == {"drive_1.mcap": b"12345", "metadata.yaml": b"1"}
    assert written.foreign_members(adopted) == []
    written.adopt(adopted / "metadata.yaml", written.root / "file")
    assert (written.root / "file").read_bytes() == b"1"
    assert written.foreign_files([written.root / "file"]) == []


def test_adopted_files_are_on_the_disk_before_they_are_listed(written, adopted, monkeypatch):
    """Else a power cut would leave shorter files, which would be foreign."""
    later = written.root / ".new/drive"
    complete = {file.stat().st_ino for file in later.iterdir()}
    (listing,) = (written.root / FILE_LISTS).iterdir()
    listing_number = listing.stat().st_ino
    synced = []
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(os.fstat(handle).st_ino))
    adopt_later(written)
    assert {*synced[: synced.index(listing_number)]} == complete


def test_a_folder_that_a_power_cut_emptied_is_replaced(written, adopted):
    (adopted / "drive_0.mcap").write_bytes(b"")
    adopt_later(written)
    assert (adopted / "drive_1.mcap").exists()


ADDITIONS = {
    "an empty file": lambda folder: (folder / "COLCON_IGNORE").touch(),
    "a file": lambda folder: (folder / "notes.txt").write_text("rain"),
    "an edited file": lambda folder: (folder / "metadata.yaml").write_text("mine"),
    "an empty folder": lambda folder: (folder / "plots").mkdir(),
    "a link": lambda folder: (folder / "raw").symlink_to("/nowhere"),
    "a link to a folder": lambda folder: (folder / "raw").symlink_to(folder.parent),
}
"""Changes of a bag that users make, by what they add to it."""


@pytest.mark.parametrize("addition", ADDITIONS)
def test_a_folder_with_anything_of_the_user_stays_as_it_is(written, adopted, addition):
    ADDITIONS[addition](adopted)
    before = files_below(written.root)
    members = sorted(adopted.rglob("*"))
    with pytest.raises(OutputError) as caught:
        adopt_later(written)
    assert Path(caught.value.subject).parent == adopted
    assert files_below(written.root) == before
    assert sorted(adopted.rglob("*")) == members


def test_a_link_of_the_user_to_an_empty_folder_stays(written, adopted, tmp_path):
    adopted.rename(tmp_path / "earlier")
    (tmp_path / "empty").mkdir()
    adopted.symlink_to(tmp_path / "empty")
    with refused(OutputError, adopted):
        adopt_later(written)
    assert adopted.readlink() == tmp_path / "empty"


def test_an_earlier_folder_stays_if_the_later_one_cannot_be_moved(written, adopted):
    before = files_below(adopted)
    with pytest.raises(OSError, match=r"."):
        # No system moves a folder into itself.
        written.adopt(written.root, adopted)
    assert files_below(adopted) == before


def test_a_truncated_list_loses_one_line(written: OwnedFolder) -> None:
    for name in "ab":
        written.write(written.root / name, b"x")
    (listing,) = (written.root / FILE_LISTS).iterdir()
    listing.write_bytes(listing.read_bytes()[:-3])
    written.write(written.root / "c", b"x")
    paths = [written.root / name for name in "abc"]
    assert written.foreign_files(paths) == paths[1:2]


def test_a_file_that_cannot_be_listed_does_not_appear(written: OwnedFolder) -> None:
    written.root.mkdir()
    (written.root / FILE_LISTS).touch()
    with pytest.raises(OutputError):
        written.write(written.root / "a", b"x")
    assert not (written.root / "a").exists()


def test_many_threads_lose_no_line(written: OwnedFolder) -> None:
    paths = [written.root / f"{number:03d}" for number in range(200)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda path: written.write(path, b"x"), paths))
    assert written.written() == paths
    assert written.foreign_files(paths) == []


@pytest.mark.parametrize("name", ["../victim", "{folder}/victim", "a/../../victim", "%2e./victim"])
def test_lists_with_files_elsewhere_remove_nothing(written, tmp_path, name):
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    state = victim.stat()
    line = f"{name.format(folder=tmp_path)}\t{state.st_size}\t{state.st_mtime_ns}\n"
    (written.root / FILE_LISTS).mkdir(parents=True)
    (written.root / FILE_LISTS / "machine.tsv").write_text(line)
    assert written.written() == []
    written.remove_written(written.written())
    assert victim.exists()
