# SPDX-License-Identifier: MIT
"""Frames beside scans, and in their files."""

from dataclasses import replace
from pathlib import Path

import pytest
from scans import make_scan, refused, write_sequence

from salsanext_cli.core.errors import FormatError, OutputError
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES, encode_frames, read_frames
from salsanext_cli.runs.annotation.map_frames import (
    changed_frames,
    digest_of_frames,
    frame_of,
    frames_beside,
    missing_frames,
    refuse_lost_frames,
    write_frames,
)
from salsanext_cli.runs.annotation.picked_data_set import PickedDataSet
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans

FRAME = (500_000.0, 5_400_000.0, 0.0)
OTHER = (10_000.0, 0.0, 0.0)


@pytest.fixture
def scans(tmp_path):
    for sequence in ("07", "08"):
        write_sequence(tmp_path / "data/sequences" / sequence, ("000000", "000001"), labels=False)
    (tmp_path / "data/sequences/08" / FRAMES).write_bytes(encode_frames({"000001": FRAME}))
    return find_scans(tmp_path / "data")


def test_the_frame_of_the_file_comes_before_that_beside_it(scans):
    beside = frames_beside(scans)
    assert beside == {scans[3]: FRAME}
    around_sensor = make_scan(10)
    in_map = replace(around_sensor, notes=replace(around_sensor.notes, frame=OTHER))
    assert [frame_of(scan, around_sensor, beside) for scan in scans] == [*[NO_SHIFT] * 3, FRAME]
    assert {frame_of(scan, in_map, beside) for scan in scans} == {OTHER}


def test_scans_in_a_folder_of_the_root_have_no_frames():
    """Containers mount folders there."""
    path = Path("/not-a-folder/velodyne/000000.bin")
    scan = ScanFile(sequence="not-a-folder", stem="000000", path=path)
    assert frames_beside([scan]) == {}


def test_the_digest_is_that_of_whole_files(scans):
    every = digest_of_frames(scans)
    assert digest_of_frames(scans[2:3]) == digest_of_frames(scans[3:]) == every
    assert digest_of_frames(scans[:2]) is None
    scans[3].path.parent.with_name(FRAMES).write_bytes(encode_frames({"000001": OTHER}))
    assert digest_of_frames(scans) not in (every, None)


def add_frames(data_set, frames):
    write_frames(data_set, missing_frames(data_set, frames))


def test_frames_are_added_to_those_that_are_written(tmp_path):
    folder = tmp_path / "data/sequences/08"
    write_sequence(folder, ("000000", "000001", "000002"), labels=False)
    first, second, third = find_scans(tmp_path / "data")
    frame = (500_000.0, 5_400_000.0, 0.0)
    data_set = PickedDataSet(tmp_path / "out")
    path = tmp_path / "out/sequences/08/frames.json"
    add_frames(data_set, {second: NO_SHIFT})
    assert not path.exists()
    add_frames(data_set, {third: frame})
    add_frames(data_set, {first: frame, second: NO_SHIFT, third: (0.0, 1.0, 0.0)})
    assert read_frames(path) == {"000000": frame, "000002": frame}
    assert data_set.foreign_files([path]) == []


def test_edited_frames_of_copies_stay_and_are_refused_if_one_is_missing(tmp_path):
    write_sequence(tmp_path / "data/sequences/08", ("000000", "000001"), labels=False)
    first, second = find_scans(tmp_path / "data")
    data_set = PickedDataSet(tmp_path / "out")
    path = tmp_path / "out/sequences/08/frames.json"
    add_frames(data_set, {first: FRAME})
    edited = encode_frames({"000000": OTHER})
    path.write_bytes(edited)
    add_frames(data_set, {first: FRAME, second: NO_SHIFT})
    refused(OutputError, path, add_frames, data_set, {first: FRAME, second: FRAME})
    assert path.read_bytes() == edited
    assert data_set.foreign_files([path]) == [path]


def test_an_empty_file_of_copies_is_written_again(scans, tmp_path):
    """A power cut leaves it."""
    data_set = PickedDataSet(tmp_path / "out")
    path = tmp_path / "out/sequences/08/frames.json"
    add_frames(data_set, {scans[3]: FRAME})
    path.write_bytes(b"")
    add_frames(data_set, {scans[3]: FRAME})
    assert read_frames(path) == {"000001": FRAME}
    path.write_bytes(b"")
    write_frames(data_set, changed_frames(data_set, scans, frames_beside(scans)))
    assert read_frames(path) == {"000001": FRAME}


def test_an_ignored_file_is_refused_if_copies_of_its_sequence_have_frames(scans, tmp_path):
    data_set = PickedDataSet(tmp_path / "out")
    for scan in (scans[0], scans[3]):
        scan.path.parent.with_name(FRAMES).write_text("[]")
    refuse_lost_frames(data_set, scans)
    add_frames(data_set, {scans[3]: FRAME})
    refuse_lost_frames(data_set, scans[:2])
    source = scans[2].path.parent.with_name(FRAMES)
    refused(FormatError, source, refuse_lost_frames, data_set, scans[:3])
