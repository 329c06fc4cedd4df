# SPDX-License-Identifier: MIT
"""Scans that are not used are named: other folders, and what a search that stopped has found."""

import shlex
from pathlib import Path

import pytest
from scans import make_empty, refused

from salsanext_cli.core.errors import NoInputError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.runs.scans import scan_folders
from salsanext_cli.runs.scans.scan_search import find_scans


def found(source: Path) -> list[str]:
    return [scan.name for scan in find_scans(source)]


def test_deeper_drives_of_a_collection_are_sequences_too(tmp_path, caplog):
    make_empty(tmp_path, "first/velodyne/0.bin", "later/second/velodyne/0.bin")
    make_empty(tmp_path, "cut/sequences/first/velodyne/0.bin", "cut/.salsanext.files/host.tsv")
    (tmp_path / "newest").mkdir()
    (tmp_path / "newest/link").symlink_to(tmp_path / "first")
    with caplog.at_level(NOTICE):
        assert found(tmp_path) == ["first/0", "later_second/0"]
    used, unused = caplog.messages
    assert "later/second/velodyne (1 .bin)" in used
    assert "cut/sequences/first/velodyne (1 .bin)" in unused


@pytest.mark.parametrize(
    ("used", "unused"),
    [
        ("velodyne", "second/velodyne"),
        ("velodyne", "later/second/velodyne"),
        ("sequences/08/velodyne", "second/velodyne"),
        ("sequences/08/velodyne", "sequences/later/09/velodyne"),
        (".", "second/velodyne"),
        ("velodyne", "."),
        ("velodyne", "loose"),
        ("first/velodyne", "loose"),
        ("sequences/08/velodyne", "loose/deeper"),
    ],
)
def test_scans_that_are_not_used_are_named_with_a_command(tmp_path, caplog, used, unused):
    make_empty(tmp_path, f"{used}/0.bin")
    with caplog.at_level(NOTICE):
        before = find_scans(tmp_path)
    assert caplog.messages == []
    make_empty(tmp_path, f"{unused}/1.bin")
    with caplog.at_level(NOTICE):
        assert find_scans(tmp_path) == before
    (message,) = caplog.messages
    _, _, words = message.partition("not used: ")
    assert words.startswith(f"{unused} (1 .bin)")
    command = shlex.split(words.partition("give one as SCANS: ")[2])
    path = Path(command[2])
    (path,) = path.parent.glob(path.name)  # A shell resolves the pattern of files.
    (scan,) = find_scans(path)
    assert scan.path == tmp_path / unused / "1.bin"


def test_copies_for_labelling_tools_are_no_other_scans(tmp_path, caplog):
    make_empty(tmp_path, "sequences/08/velodyne/1.bin", ".salsanext.files/host.tsv", "pick.json")
    make_empty(tmp_path, "tools/sse/08_1.pcd", "tools/point-labeler/08/velodyne/1.bin")
    with caplog.at_level(NOTICE):
        assert found(tmp_path) == ["08/1"]
    assert caplog.messages == []
    make_empty(tmp_path, "tools/mine/1.pcd")
    with caplog.at_level(NOTICE):
        assert found(tmp_path) == ["08/1"]
    assert "tools/mine (1 .pcd)" in caplog.text
    assert "tools/sse" not in caplog.text
    (tmp_path / "pick.json").unlink()
    with caplog.at_level(NOTICE):
        assert found(tmp_path) == ["08/1"]
    assert "tools/sse (1 .pcd)" in caplog.text


def test_scans_in_a_folder_of_tools_beside_results_are_scans(tmp_path):
    make_empty(tmp_path, "tools/1.pcd", ".salsanext.files/host.tsv", "sequences/08/ply/1.ply")
    assert found(tmp_path) == ["tools/1"]


@pytest.mark.parametrize(
    "others",
    [
        ["other/1.pcd"],
        ["samples/LIDAR_TOP/1.pcd.bin", "drive_0001_sync/velodyne_points/data/1.bin"],
    ],
)
def test_clouds_below_a_folder_of_tables_are_named(tmp_path, caplog, others):
    make_empty(tmp_path, "a.npy", *others, "more/1.csv")
    with caplog.at_level(NOTICE):
        assert found(tmp_path) == [f"{tmp_path.name}/a"]
    (message,) = caplog.messages
    for other in others:
        assert f"salsanext predict {(tmp_path / other).parent} out" in message
    assert "more" not in message


def test_the_search_is_bounded(tmp_path, monkeypatch):
    deep = "/".join(f"{n}" for n in range(scan_folders.MAX_DEPTH))
    make_empty(tmp_path, f"{deep}/1.pcd")
    assert len(found(tmp_path)) == 1
    make_empty(tmp_path / "deeper", f"{deep}/one more/1.pcd")
    refused(NoInputError, tmp_path / "deeper", find_scans, tmp_path / "deeper")


def test_a_search_that_stopped_names_what_it_found(tmp_path, monkeypatch):
    make_empty(tmp_path, *(f"photos/{n}.jpg" for n in range(20)), "clouds/1.pcd")
    make_empty(tmp_path / "empty", *(f"photos/{n}.jpg" for n in range(30)))
    monkeypatch.setattr(scan_folders.search_below, "__defaults__", (20,))
    error = refused(NoInputError, tmp_path, find_scans, tmp_path).value
    assert "clouds (1 .pcd)" in error.problem
    assert "stopped after 20 files" in error.problem
    assert f"salsanext predict {tmp_path}/clouds out" in error.hint
    error = refused(NoInputError, tmp_path / "empty", find_scans, tmp_path / "empty").value
    assert "over 20 files" in error.problem


def test_a_search_beside_tables_and_scans_that_stopped_says_so(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("salsanext_cli.runs.scans.scan_search.MAX_ENTRIES_BESIDE_TABLES", 20)
    monkeypatch.setattr("salsanext_cli.runs.scans.scan_search.MAX_ENTRIES_BESIDE_SCANS", 20)
    for root in ("tables", "only tables", "scans"):
        make_empty(tmp_path / root, *(f"trip/photos/{n}.jpg" for n in range(20)))
    make_empty(tmp_path / "tables", "1.csv", "drive/lidar/1.bin", "drive/lidar/poses.json")
    error = refused(NoInputError, tmp_path / "tables", find_scans, tmp_path / "tables").value
    assert f"salsanext predict {tmp_path}/tables/drive/lidar out" in error.hint
    assert f"salsanext predict {tmp_path}/tables/*.csv out" in error.hint
    make_empty(tmp_path / "only tables", "1.csv")
    assert found(tmp_path / "only tables") == ["only tables/1"]
    make_empty(tmp_path / "scans", "1.pcd")
    with caplog.at_level(NOTICE):
        assert found(tmp_path / "scans") == ["scans/1"]
    (message,) = caplog.messages
    assert "stopped after 20 files" in message
