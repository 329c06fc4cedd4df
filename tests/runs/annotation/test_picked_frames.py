# SPDX-License-Identifier: MIT
"""Frames of picked scans in the record of `pick`."""

import json

import numpy as np
import pytest
from las_files import write_las
from scans import make_scan, refused

from salsanext_cli.commands.stages.pick import pick
from salsanext_cli.core.errors import FormatError, OutputError
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES, read_frames
from salsanext_cli.runs.annotation import picked_frames as module
from salsanext_cli.runs.annotation.picked_frames import (
    PickedFrame,
    origins_of,
    picked_frames,
    require_recorded_frames,
    sequences_without_file,
)
from salsanext_cli.runs.scans.scan_file import ScanFile

FRAME = (500_000.0, 5_400_000.0, 0.0)
OTHER = (10_000.0, 0.0, 0.0)


@pytest.fixture
def picked(tmp_path):
    """Return a folder of two scans, the first of which was moved out of a map."""
    folder = tmp_path / "sequences/08/velodyne"
    folder.mkdir(parents=True)
    frames = {"08/000000": {"origin": FRAME, "is_beside": False}, "08/000001": None}
    (tmp_path / "pick.json").write_text(json.dumps({"stage": "pick", "frames": frames}))
    return folder


def test_the_frame_of_a_file_comes_before_that_beside_it(tmp_path):
    scans = [ScanFile(sequence=str(n), stem="a", path=tmp_path / f"{n}/a.bin") for n in range(3)]
    stated = dict(zip(scans, (FRAME, NO_SHIFT, NO_SHIFT), strict=True))
    frames = picked_frames(stated, {scans[0]: OTHER, scans[1]: OTHER})
    assert frames == {
        "0/a": PickedFrame(origin=FRAME, is_beside=False),
        "1/a": PickedFrame(origin=OTHER, is_beside=True),
        "2/a": None,
    }
    assert sequences_without_file(frames) == {"0"}
    both = {"0/b": PickedFrame(origin=OTHER, is_beside=True)}
    assert sequences_without_file({**frames, **both}) == set()
    assert [*origins_of(frames, scans).values()] == [FRAME, OTHER, NO_SHIFT]


def test_a_changed_frame_is_used_with_a_warning(picked, caplog):
    require_recorded_frames(picked, {"000000", "000001"}, {"000000": FRAME, "000001": FRAME})
    assert not caplog.text
    require_recorded_frames(picked, {"000001"}, {})
    require_recorded_frames(picked, {"000000"}, {"000000": OTHER})
    assert f"{picked.with_name(FRAMES)}: frames of 000000 differ from those in" in caplog.text


def test_a_record_that_cannot_be_read_is_refused(picked):
    """It may be that of `pick`, without which points in a map would pass for local ones."""
    record = picked.parents[2] / "pick.json"
    record.unlink()
    record.symlink_to(record)  # The system refuses it, as without permission.
    refused(FormatError, record, require_recorded_frames, picked, {"000000"}, {})


def test_damaged_frames_in_a_record_are_refused(picked):
    record = picked.parents[2] / "pick.json"
    record.write_text('{"stage": "pick", "frames": {"08/000000": 3}}')
    refused(OutputError, record, require_recorded_frames, picked, {"000000"}, {})


@pytest.mark.parametrize("missing", [(FRAMES, "velodyne/000000.bin"), (FRAMES,)])
def test_a_frame_that_could_not_be_read_once_is_recorded_by_the_next_run(
    missing, world, tmp_path, monkeypatch
):
    """As of a scan on a network disk, picked by a version that recorded no frames."""
    pytest.importorskip("laspy")
    points = make_scan(1500).points + np.array(FRAME)
    path = write_las(tmp_path / "drive/000000.las", points, offsets=FRAME)

    def picking():
        return pick(path, world.out, count=1, settings=world.network).outcome

    assert picking().done == 1
    record = world.out / "pick.json"
    content = json.loads(record.read_text())
    frames = content.pop("frames")
    assert frames == {"drive/000000": {"origin": list(FRAME), "is_beside": False}}
    record.write_text(json.dumps(content))
    for name in missing:  # As an interrupted run, or lost
        (world.out / "sequences/drive" / name).unlink()
    with monkeypatch.context() as patch:

        def unread(*_):
            raise FormatError(path, "cannot be read", "a scan")

        patch.setattr(module, "read_scan", unread)
        (failure,) = picking().failures
        assert "again" in failure.hint
        assert json.loads(record.read_text())["frames"] == {}
    assert picking().done == 1
    assert json.loads(record.read_text())["frames"] == frames
    assert read_frames(world.out / "sequences/drive" / FRAMES) == {"000000": FRAME}
