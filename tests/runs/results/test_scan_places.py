# SPDX-License-Identifier: MIT
"""Places of scans, compared with the recorded ones, and data sets that hints name."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from scans import write_sequence
from world import begin_and_end

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.core.wording import spelled
from salsanext_cli.runs.results.making_commands import FUSE
from salsanext_cli.runs.results.scan_places import PlaceState, place_state
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans


def ask(world, scans):
    """Write the record that `predict` writes before its first scan."""
    begin_and_end(world.out, "predict", {}, ["predictions"], scans)


def test_the_places_of_many_scans_take_few_calls_of_the_system(world, tmp_path, monkeypatch):
    scans = find_scans(world.data)
    ask(world, scans)
    moved = [replace(scan, path=tmp_path / "new" / scan.name) for scan in scans]
    many = [replace(scan, path=scan.path.with_name(scan.path.name + ".bin")) for scan in moved] * 20
    shutil.rmtree(world.data)
    status, calls = Path.stat, []

    def counted(path, **how):
        calls.append(path)
        return status(path, **how)

    monkeypatch.setattr(Path, "stat", counted)
    assert place_state(world.out, many) is PlaceState.MOVED
    assert len(calls) < 4 * len(many)


def test_scans_are_moved_if_their_recorded_files_are_gone(world, tmp_path):
    scans = find_scans(world.data)
    ask(world, scans)
    copied = find_scans(shutil.copytree(world.data, tmp_path / "copy"))
    assert place_state(world.out, scans) is PlaceState.RECORDED
    assert place_state(world.out, copied) is PlaceState.OTHER
    scans[0].path.unlink()
    assert place_state(world.out, copied) is PlaceState.OTHER, "scans of another sequence are there"
    assert place_state(world.out, copied[:1]) is PlaceState.MOVED
    renamed = replace(copied[0], path=copied[0].path.with_suffix(".ply"))
    assert place_state(world.out, [renamed]) is PlaceState.OTHER


def test_scans_of_a_recording_are_moved_if_it_is_gone(world, tmp_path):
    recording = tmp_path / "drive.bag"
    recording.touch()
    ask(world, [ScanFile(sequence="drive", stem="1", path=recording / "points/1")])
    link = tmp_path / "link.bag"
    link.symlink_to(recording)
    for path, state in (
        (link / "points/1", PlaceState.LINKED),
        (link / "others/1", PlaceState.OTHER),
        (tmp_path / "elsewhere/drive.bag/points/1", PlaceState.OTHER),
    ):
        scan = ScanFile(sequence="drive", stem="1", path=path)
        assert place_state(world.out, [scan]) is state
    recording.unlink()
    assert place_state(world.out, [scan]) is PlaceState.MOVED


def dataset_of_hint(world, scans) -> str:
    """Return the data set that the command of a hint names."""
    with spelled(CommandLine()):
        return FUSE.text(world.out, scans).partition(" --dataset ")[2]


def test_a_hint_names_a_data_set_only_if_all_drives_were_moved_there(world, tmp_path):
    """`fuse` needs the scans of all results in one data set."""
    scans = find_scans(world.data)
    ask(world, scans)
    new = tmp_path / "new"
    (new / "sequences").mkdir(parents=True)
    moved = (world.data / "sequences/08").rename(new / "sequences/08")
    mixed = [scans[0], *find_scans(moved)]
    assert [scan.sequence for scan in mixed] == ["00", "08", "08"]
    assert dataset_of_hint(world, mixed) == "DATASET"
    (world.data / "sequences/00").rename(new / "sequences/00")
    assert dataset_of_hint(world, find_scans(new)) == str(new)


def test_a_hint_names_none_of_several_data_sets(world, tmp_path):
    names = {"first": "01", "second": "02"}
    for data_set, sequence in names.items():
        write_sequence(tmp_path / "old" / data_set / "sequences" / sequence)
    ask(world, [scan for name in names for scan in find_scans(tmp_path / "old" / name)])
    (tmp_path / "old").rename(tmp_path / "new")
    assert dataset_of_hint(world, find_scans(tmp_path / "new/first")) == "DATASET"


@pytest.mark.parametrize("second", ["old/d2", "far/from/d2"])
def test_a_hint_names_the_folder_of_drives_only_if_all_were_moved_there(world, tmp_path, second):
    drives = [tmp_path / "old/d1", tmp_path / second]
    for drive in drives:
        write_sequence(drive, ["000000"])
    scans = [scan for drive in drives for scan in find_scans(drive)]
    ask(world, scans)
    assert [scan.sequence for scan in scans] == ["d1", "d2"]
    (tmp_path / "new").mkdir()
    first = find_scans(drives[0].rename(tmp_path / "new/d1"))
    assert dataset_of_hint(world, first) == "DATASET"
    if second == "old/d2":
        drives[1].rename(tmp_path / "new/d2")
        assert dataset_of_hint(world, first) == str(tmp_path / "new")
