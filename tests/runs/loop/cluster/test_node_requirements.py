# SPDX-License-Identifier: MIT
"""What a run needs of each node: versions, the first scan, and folders with a probe."""

import os
import time
from dataclasses import replace
from pathlib import Path

import pytest

from salsanext_cli.runs.loop.cluster import node_requirements as node_requirements_module
from salsanext_cli.runs.loop.cluster.node_code import node_problem
from salsanext_cli.runs.loop.cluster.node_requirements import node_requirements, probe_of
from salsanext_cli.runs.loop.run_folders import RunFolders
from salsanext_cli.runs.scans.scan_file import ScanFile


@pytest.fixture
def scans(tmp_path):
    path = tmp_path / "scan.bin"
    path.write_bytes(b"1234")
    return [ScanFile(sequence="s", stem="scan", path=path)]


def test_nodes_need_the_first_scan_and_the_folders(tmp_path, scans):
    before = tmp_path / "before"
    out = tmp_path / "out"
    before.mkdir()
    out.mkdir()
    folders = RunFolders(writes=(out,), reads=(before, out))
    with node_requirements(scans, folders) as required:
        assert [(file.path, file.size) for file in required.files] == [(str(scans[0].path), 4)]
        found = [(folder.path, folder.is_written) for folder in required.folders]
        assert found == [(str(before), False), (str(out), True)]
        assert node_problem(required) is None
    assert not [*out.iterdir(), *before.iterdir()]


def test_scans_of_recordings_and_new_folders_are_those_above_them(tmp_path, scans):
    bag = [ScanFile(sequence="s", stem="1", path=scans[0].path / "topic/1")]
    with node_requirements(bag, RunFolders(writes=(tmp_path / "new/out",))) as required:
        assert required.files[0].path == str(scans[0].path)
        assert [folder.path for folder in required.folders] == [str(tmp_path)]
    with node_requirements(bag, RunFolders()) as required:
        assert required.folders == ()


def test_a_node_with_another_folder_lacks_it(tmp_path, scans):
    """Its own file of the same name and size has other content."""
    out = tmp_path / "out"
    out.mkdir()
    with node_requirements(scans, RunFolders(reads=(out,))) as required:
        (probe,) = out.iterdir()
        probe.write_bytes(bytes(probe.stat().st_size))
        assert f"has another {out}" in node_problem(required).text
        probe.unlink()
        assert f"has another {out}" in node_problem(required).text
        out.rmdir()
        assert f"cannot read {out}" in node_problem(required).text


def test_nodes_need_the_plug_ins(scans, monkeypatch):
    monkeypatch.setattr(node_requirements_module, "plug_in_packages", lambda: ["radian-lidar"])
    with node_requirements(scans, RunFolders()) as required:
        assert "radian-lidar" in required.versions
        versions = {**required.versions, "radian-lidar": "1.0"}
    assert "lacks radian-lidar" in node_problem(replace(required, versions=versions)).text


def test_nodes_are_told_which_modules_there_are_here(scans):
    with node_requirements(scans, RunFolders()) as required:
        assert {"numpy", "torch", "typer"} <= required.modules
        assert "absent_package" not in required.modules


def test_files_of_other_runs_in_the_folder_may_change(tmp_path, scans):
    lock = tmp_path / ".lock"
    lock.write_bytes(b"")
    with node_requirements(scans, RunFolders(writes=(tmp_path,))) as required:
        lock.write_bytes(b"longer")
        assert node_problem(required) is None
        lock.unlink()
        assert node_problem(required) is None


def test_a_probe_stays_recent_during_a_long_run(tmp_path, monkeypatch):
    monkeypatch.setattr(node_requirements_module, "RENEWAL_INTERVAL_S", 0.001)
    with probe_of(tmp_path) as probe:
        path = Path(probe.path)
        os.utime(path, (0, 0))
        end = time.monotonic() + 20.0
        while path.stat().st_mtime == 0:
            assert time.monotonic() < end
    assert not path.exists()


def test_the_probe_of_a_folder_that_is_read_only_is_its_record(tmp_path, scans, monkeypatch):
    record = tmp_path / "predict.json"
    record.write_bytes(b"{}")

    def refuse(path, content):
        path.touch()  # The disk may become full halfway.
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with node_requirements(scans, RunFolders(reads=(tmp_path,))) as required:
        (folder,) = required.folders
        assert folder.probe.path == str(record)
        assert node_problem(required) is None
        other = replace(folder, probe=replace(folder.probe, content=b"[]"))
        assert f"has another {tmp_path}" in node_problem(replace(required, folders=(other,))).text
    record.unlink()
    with probe_of(tmp_path) as probe:
        assert probe is None
    assert not [*tmp_path.glob(".*")]
