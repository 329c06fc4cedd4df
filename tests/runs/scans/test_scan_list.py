# SPDX-License-Identifier: MIT
"""Lists of scans as a source: the same scans as their paths, and errors that name lines."""

from pathlib import Path

import pytest
from scans import refused, write_sequence

from salsanext_cli.core.errors import FormatError, NoInputError, SalsanextError
from salsanext_cli.runs.scans.scan_list import list_of
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.selection import scans_of


@pytest.fixture
def lists(tmp_path):
    """Return a folder beside that of two sequences."""
    for sequence in ("a", "b"):
        write_sequence(tmp_path / "data" / sequence, ["0", "1", "2"])
    (tmp_path / "lists").mkdir()
    return tmp_path / "lists"


def source_of(path, content):
    path.write_bytes(content)
    return Path(f"@{path}")


def test_a_list_has_the_scans_of_its_paths(lists, tmp_path, monkeypatch):
    scan = "../data/a/velodyne/{}.bin".format
    absolute = tmp_path / "data/b/velodyne/1.bin"
    lines = ["\ufeff# chosen", "", f"  {scan(2)} ", scan(0), f"#{scan(1)}", scan(2), str(absolute)]
    for end in ("\n", "\r\n"):
        source = source_of(lists / "list.txt", end.join(lines).encode())
        found = find_scans(source)
        assert [file.name for file in found] == ["a/0", "a/2", "b/1"]
        assert {file.path for file in found} <= {
            file.path for file in find_scans(tmp_path / "data")
        }
        assert scans_of(source) == scans_of([source, absolute]) == found
    monkeypatch.chdir(lists)
    assert find_scans(Path("@list.txt")) == found
    monkeypatch.chdir(tmp_path)
    assert find_scans(Path("@lists/list.txt")) == found


def test_folders_and_clouds_of_recordings_may_be_listed(lists, tmp_path):
    source = source_of(lists / "list.txt", b"../data/a\n../data/b/velodyne/0.bin")
    assert [file.name for file in find_scans(source)] == ["a/0", "a/1", "a/2", "b/0"]


def test_missing_files_are_named_with_their_lines(lists):
    lines = ["# list", "../data/a/velodyne/0.bin", "", "gone.bin", "../data/a/velodyne/9.bin"]
    source = source_of(lists / "list.txt", "\n".join(lines).encode())
    with pytest.raises(NoInputError) as caught:
        find_scans(source)
    assert caught.value.subject == str(lists / "list.txt")
    assert f"line 4: {lists / 'gone.bin'}" in caught.value.problem
    assert "line 5: " in caught.value.problem
    assert "line 2" not in caught.value.problem


def test_a_path_without_scans_is_named_with_its_line(lists):
    (lists / "notes.doc").write_bytes(b"")
    source = source_of(lists / "list.txt", b"# list\nnotes.doc\n")
    error = refused(NoInputError, f"{lists / 'list.txt'}, line 2", find_scans, source)
    assert str(lists / "notes.doc") in str(error.value)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"", NoInputError),
        (b"# nothing\n\n", NoInputError),
        (b"a\x00b.bin\n", FormatError),
        (b"\xff\xfe0\x008\x00", FormatError),
    ],
)
def test_lists_without_paths_are_refused(lists, content, kind):
    source = source_of(lists / "list.txt", content)
    refused(kind, lists / "list.txt", find_scans, source)


def test_a_list_that_is_missing_or_a_folder_is_refused(lists):
    refused(FormatError, lists / "none.txt", find_scans, Path(f"@{lists / 'none.txt'}"))
    refused(FormatError, lists, find_scans, Path(f"@{lists}"))


def test_lists_do_not_list_lists(lists):
    (lists / "a.txt").write_text("../data/a")
    source = source_of(lists / "list.txt", b"@a.txt\n")
    refused(NoInputError, lists / "list.txt", find_scans, source)


def test_scans_of_one_name_are_refused_as_in_folders(lists, tmp_path):
    write_sequence(tmp_path / "other/a", ["0"])
    source = source_of(lists / "list.txt", b"../data/a/velodyne/0.bin\n../other/a/velodyne/0.bin\n")
    with pytest.raises(SalsanextError) as of_list:
        find_scans(source)
    with pytest.raises(SalsanextError) as of_paths:
        scans_of([tmp_path / "data/a/velodyne/0.bin", tmp_path / "other/a/velodyne/0.bin"])
    assert (of_list.type, str(of_list.value)) == (of_paths.type, str(of_paths.value))


def test_a_folder_whose_name_begins_with_the_mark_is_that_folder(tmp_path, monkeypatch):
    write_sequence(tmp_path / "@drive", ["0"])
    monkeypatch.chdir(tmp_path)
    assert list_of(Path("@drive")) is None
    assert [file.stem for file in find_scans(Path("@drive"))] == ["0"]
    assert list_of(Path("@")) is None
    assert list_of(Path("drive/@list.txt")) is None
    assert list_of(Path("@list.txt")) == Path("list.txt")
