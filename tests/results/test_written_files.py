# SPDX-License-Identifier: MIT
"""Files that salsanext wrote are known again; those of anybody else are never removed."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from salsanext_cli.errors import OutputError
from salsanext_cli.results.written_files import RECORDS, WrittenFiles


@pytest.fixture
def written(tmp_path: Path) -> WrittenFiles:
    return WrittenFiles(tmp_path / "out")


@pytest.mark.parametrize(
    "name", ["a.label", "deep/er/ü ä.npy", "tab\tline\nend", "b\udcffad", "%41"]
)
def test_a_written_file_is_ours(written: WrittenFiles, name: str) -> None:
    path = written.folder / name
    written.write(path, b"once before")
    written.write(path, b"content")
    assert path.read_bytes() == b"content"
    assert written.others([path]) == []
    assert written.recorded() == [path]
    assert written.remove([path]) == []
    assert not path.exists()
    assert written.recorded() == []


def test_files_of_others_are_kept(written: WrittenFiles) -> None:
    """Edited, touched, put there by hand, or put in the place of one of ours."""
    ours, *others = (written.folder / name for name in ("ours", "edited", "touched", "replaced"))
    for path in (ours, *others):
        written.write(path, b"1234")
    others[0].write_bytes(b"12345")
    os.utime(others[1], ns=(0, others[1].stat().st_mtime_ns + 1))
    others[2].unlink()
    others[2].symlink_to(ours)
    foreign = written.folder / "foreign"
    foreign.write_bytes(b"mine")
    assert written.others([ours, *others, foreign]) == [*others, foreign]
    assert written.remove([ours, *others, foreign]) == [*others, foreign]
    assert sorted(path.name for path in written.folder.iterdir() if path.name[0] != ".") == [
        *("edited", "foreign", "replaced", "touched")
    ]


def test_nothing_is_removed_through_a_link(written: WrittenFiles, tmp_path: Path) -> None:
    path = written.folder / "sequences/00/a.bin"
    written.write(path, b"scan")
    path.parent.rename(tmp_path / "elsewhere")
    path.parent.symlink_to(tmp_path / "elsewhere")
    assert written.remove([path]) == [path]
    assert path.read_bytes() == b"scan"


def test_the_folder_itself_may_be_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    written = WrittenFiles(tmp_path / "out")
    written.write(tmp_path / "out/a", b"a")
    assert written.others([tmp_path / "out/a"]) == []


def test_an_empty_file_is_nobodys_loss(written: WrittenFiles) -> None:
    """A power cut can leave one that had just got its name."""
    written.folder.mkdir()
    (written.folder / "empty").touch()
    assert written.others([written.folder / "empty", written.folder / "none"]) == []


def test_a_record_that_was_cut_off_costs_one_line(written: WrittenFiles) -> None:
    for name in "ab":
        written.write(written.folder / name, b"x")
    (record,) = (written.folder / RECORDS).iterdir()
    record.write_bytes(record.read_bytes()[:-3])
    written.write(written.folder / "c", b"x")
    paths = [written.folder / name for name in "abc"]
    assert written.others(paths) == paths[1:2]


def test_a_file_that_could_not_be_recorded_does_not_appear(written: WrittenFiles) -> None:
    written.folder.mkdir()
    (written.folder / RECORDS).touch()
    with pytest.raises(OutputError, match="cannot be written"):
        written.write(written.folder / "a", b"x")
    assert not (written.folder / "a").exists()


def test_many_at_once_lose_no_line(written: WrittenFiles) -> None:
    paths = [written.folder / f"{number:03d}" for number in range(200)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda path: written.write(path, b"x"), paths))
    assert written.recorded() == paths
    assert written.others(paths) == []


@pytest.mark.parametrize("name", ["../victim", "{folder}/victim", "a/../../victim", "%2e./victim"])
def test_records_that_name_files_elsewhere(
    written: WrittenFiles, tmp_path: Path, name: str
) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    found = victim.stat()
    line = f"{name.format(folder=tmp_path)}\t{found.st_size}\t{found.st_mtime_ns}\n"
    (written.folder / RECORDS).mkdir(parents=True)
    (written.folder / RECORDS / "machine.tsv").write_text(line)
    assert written.recorded() == []
    written.remove(written.recorded())
    assert victim.exists()
