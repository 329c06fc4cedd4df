# SPDX-License-Identifier: MIT
"""Files that salsanext wrote are known again; those of anybody else are never removed."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from salsanext_cli.errors import OutputError
from salsanext_cli.results.owned_folder import FILE_LISTS, OwnedFolder


@pytest.fixture
def written(tmp_path: Path) -> OwnedFolder:
    return OwnedFolder(tmp_path / "out")


def test_damaged_findings_are_named(tmp_path: Path) -> None:
    for content in ('{"scans": []}', '{"scans": {"08/0": 3}}', '{"scans": {"08/0": [["few"]]}}'):
        (tmp_path / "predict.warnings.json").write_text(content)
        with pytest.raises(OutputError, match=r"predict\.warnings\.json"):
            OwnedFolder(tmp_path, "predict").findings()


@pytest.mark.parametrize(
    "name", ["a.label", "deep/er/ü ä.npy", "tab\tline\nend", "b\udcffad", "%41"]
)
def test_a_written_file_is_ours(written: OwnedFolder, name: str) -> None:
    path = written.root / name
    written.write(path, b"once before")
    written.write(path, b"content")
    assert path.read_bytes() == b"content"
    assert written.foreign_files([path]) == []
    assert written.written() == [path]
    assert written.remove_written([path]) == []
    assert not path.exists()
    assert written.written() == []


def test_files_of_others_are_kept(written: OwnedFolder) -> None:
    """Edited, touched, put there by hand, or put in the place of one of ours."""
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


def test_nothing_is_removed_through_a_link_below_a_folder_that_may_be_one(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    written, path = OwnedFolder(tmp_path / "out"), tmp_path / "out/sequences/00/a.bin"
    written.write(path, b"scan")
    assert written.foreign_files([path]) == []
    path.parent.rename(tmp_path / "elsewhere")
    path.parent.symlink_to(tmp_path / "elsewhere")
    assert written.remove_written([path]) == [path]
    assert path.read_bytes() == b"scan"


def test_an_empty_file_is_nobodys_loss(written: OwnedFolder) -> None:
    """A power cut can leave one that had just got its name."""
    written.root.mkdir()
    (written.root / "empty").touch()
    assert written.foreign_files([written.root / "empty", written.root / "none"]) == []


def test_a_record_that_was_cut_off_costs_one_line(written: OwnedFolder) -> None:
    for name in "ab":
        written.write(written.root / name, b"x")
    (record,) = (written.root / FILE_LISTS).iterdir()
    record.write_bytes(record.read_bytes()[:-3])
    written.write(written.root / "c", b"x")
    paths = [written.root / name for name in "abc"]
    assert written.foreign_files(paths) == paths[1:2]


def test_a_file_that_could_not_be_recorded_does_not_appear(written: OwnedFolder) -> None:
    written.root.mkdir()
    (written.root / FILE_LISTS).touch()
    with pytest.raises(OutputError, match="cannot be written"):
        written.write(written.root / "a", b"x")
    assert not (written.root / "a").exists()


def test_many_at_once_lose_no_line(written: OwnedFolder) -> None:
    paths = [written.root / f"{number:03d}" for number in range(200)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda path: written.write(path, b"x"), paths))
    assert written.written() == paths
    assert written.foreign_files(paths) == []


@pytest.mark.parametrize("name", ["../victim", "{folder}/victim", "a/../../victim", "%2e./victim"])
def test_records_that_name_files_elsewhere(written: OwnedFolder, tmp_path: Path, name: str) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    found = victim.stat()
    line = f"{name.format(folder=tmp_path)}\t{found.st_size}\t{found.st_mtime_ns}\n"
    (written.root / FILE_LISTS).mkdir(parents=True)
    (written.root / FILE_LISTS / "machine.tsv").write_text(line)
    assert written.written() == []
    written.remove_written(written.written())
    assert victim.exists()
