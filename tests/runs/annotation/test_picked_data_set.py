# SPDX-License-Identifier: MIT
"""Settings of `pick`, and poses of picked scans."""

import numpy as np
import pytest
from las_files import write_las
from scans import SMALL, make_scan, refused, write_sequence

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES, encode_frames, read_frames
from salsanext_cli.runs.annotation.map_frames import frames_beside, missing_frames, write_frames
from salsanext_cli.runs.annotation.picked_data_set import PickedDataSet, PickSettings
from salsanext_cli.runs.records.stage_settings import ComputedSettings
from salsanext_cli.runs.results.manifest import settings_json
from salsanext_cli.runs.scans.scan_search import find_scans


@pytest.mark.parametrize(
    ("stems", "lines", "picked"),
    [
        (("000000", "000002"), 9, "line 0\nline 2\n"),
        (("000001", "000002"), 2, "line 0\nline 1\n"),
        (("000001", "000002"), 9, None),
    ],
)
def test_poses_with_ambiguous_names_are_skipped(tmp_path, caplog, stems, lines, picked):
    folder = tmp_path / "data/sequences/08"
    write_sequence(folder, stems, labels=False)
    (folder / "poses.txt").write_text("".join(f"line {n}\n" for n in range(lines)))
    frames = dict.fromkeys(find_scans(tmp_path / "data"), NO_SHIFT)
    PickedDataSet(tmp_path / "out").write_poses(frames)
    target = tmp_path / "out/sequences/08/poses.txt"
    assert (target.read_text() if target.exists() else None) == picked
    assert ("poses.txt: " in caplog.text) == (picked is None)


def test_scans_in_a_map_have_the_frame_of_their_copies_and_no_poses(tmp_path, caplog):
    pytest.importorskip("laspy")
    points = make_scan(200).points + np.array([500_123.4, 5_400_456.7, 312.0])
    folder = tmp_path / "data/sequences/08/velodyne"
    path = write_las(folder / "000003.las", points, offsets=(5e5, 5.4e6, 0))
    path.parents[1].joinpath("poses.txt").write_text("line\n")
    (scan,) = find_scans(tmp_path / "data")
    data_set = PickedDataSet(tmp_path / "out")
    frame = read_scan(path).notes.frame
    assert frame != NO_SHIFT
    refused(FormatError, path, data_set.write_points, scan, SMALL, {}, NO_SHIFT)
    data_set.write_points(scan, SMALL, {}, frame)
    write_frames(data_set, missing_frames(data_set, {scan: frame}))
    data_set.write_poses({scan: frame})
    sequence = tmp_path / "out/sequences/08"
    assert read_frames(sequence / "frames.json") == {"000003": frame}
    copied = read_scan(sequence / "velodyne/000003.bin").points
    assert np.abs(copied + np.array(frame) - points).max() < 0.8e-3
    assert not (sequence / "poses.txt").exists()
    assert str(path.parents[1] / "poses.txt") in caplog.text


def test_copies_of_scans_need_their_recorded_frame(tmp_path):
    """Scans of `convert` or `pick` have it beside them."""
    folder = tmp_path / "data/sequences/08"
    write_sequence(folder, ("000000", "000001"), labels=False)
    frame = (500_000.0, 5_400_000.0, 0.0)
    (folder / FRAMES).write_bytes(encode_frames({"000001": frame}))
    data_set = PickedDataSet(tmp_path / "out")
    first, second = find_scans(tmp_path / "data")
    beside = frames_beside([first, second])
    refused(FormatError, first.path, data_set.write_points, first, SMALL, beside, frame)
    refused(FormatError, second.path, data_set.write_points, second, SMALL, beside, NO_SHIFT)
    data_set.write_points(first, SMALL, beside, NO_SHIFT)
    data_set.write_points(second, SMALL, beside, frame)
    assert len(find_scans(tmp_path / "out")) == 2


def test_the_settings_are_one_table_with_those_of_the_network():
    network = ComputedSettings(weights="abc", precision="float32", trained_on="0" * 24)
    settings = PickSettings(
        network=network, count=10, seed=0, scans="3, abc", labelled=None, samples=8
    )
    # The order is that of earlier versions.
    assert [*settings_json(settings).items()] == [
        ("weights", "abc"),
        ("precision", "float32"),
        ("samples", 8),
        ("seed", 0),
        ("trained_on", "0" * 24),
        ("count", 10),
        ("scans", "3, abc"),
        ("strategy", "both"),
    ]
