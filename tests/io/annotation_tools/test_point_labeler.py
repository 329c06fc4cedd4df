# SPDX-License-Identifier: MIT
"""Folders of point_labeler, which edits label files in place."""

from dataclasses import replace

import numpy as np
import pytest
from picked_for_tools import SEQUENCES, SPACE, PickedForTool
from scans import SMALL, files_below, make_scan, refused

from salsanext_cli import read_scan
from salsanext_cli.core.errors import UsageError
from salsanext_cli.io.annotation_tools.point_labeler import APART_M, PointLabeler
from salsanext_cli.io.annotation_tools.tool import LabelledPoints
from salsanext_cli.io.frames import FRAMES, encode_frames
from salsanext_cli.runs.annotation.tool_files import SensorPositions

SCAN = ("08", "000011")


@pytest.fixture
def picked(tmp_path):
    return PickedForTool(tmp_path, "point-labeler")


def opened_poses(folder):
    """Return the poses as the tool computes them: from the LiDAR, by a calibration."""

    def matrix(words):
        return np.vstack([np.array(words, float).reshape(3, 4), [0, 0, 0, 1]])

    (line,) = (folder / "calib.txt").read_text().splitlines()
    assert line.startswith("Tr: ")
    lidar_to_camera = matrix(line.split()[1:])
    poses = [matrix(line.split()) for line in (folder / "poses.txt").read_text().splitlines()]
    return [np.linalg.inv(lidar_to_camera) @ pose @ lidar_to_camera for pose in poses]


def test_each_sequence_is_a_folder_of_the_benchmark(picked):
    picked.write()
    names = [
        f"{sequence}/{name}"
        for sequence, stems in SEQUENCES.items()
        for name in (
            "calib.txt",
            "poses.txt",
            *(f"labels/{stem}.label" for stem in stems),
            *(f"velodyne/{stem}.bin" for stem in stems),
        )
    ]
    assert sorted(files_below(picked.folder)) == sorted(names)
    for sequence, stem in picked.scans:
        for name in (f"velodyne/{stem}.bin", f"labels/{stem}.label"):
            original = picked.root / "sequences" / sequence / name
            assert (picked.folder / sequence / name).read_bytes() == original.read_bytes()


def test_scans_without_poses_are_shown_apart(picked):
    picked.write()
    first, second = opened_poses(picked.folder / "08")
    np.testing.assert_array_equal(first, np.eye(4))
    np.testing.assert_array_equal(second[:3, 3], [APART_M, 0, 0])
    assert len(opened_poses(picked.folder / "09")) == 1


def test_poses_of_the_camera_are_those_of_the_lidar_to_the_tool(picked):
    sequence = picked.root / "sequences/08"
    # The axes of the camera: x right, y down, z forward.
    (sequence / "calib.txt").write_text(
        "P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
    )
    (sequence / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 5\n")
    picked.write()
    first, second = opened_poses(picked.folder / "08")
    np.testing.assert_allclose(first, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(second[:3, 3], [5, 0, 0], atol=1e-12)


def test_the_way_begins_at_the_origin(picked):
    """The tool has a tile for each 100 m from the origin, and single precision."""
    rows = (
        "0 -1 0 691234.5 1 0 0 5334567.25 0 0 1 510",
        "1 0 0 691239.5 0 1 0 5334560.25 0 0 1 511",
    )
    (picked.root / "sequences/08/poses.txt").write_text("\n".join(rows))
    picked.write()
    first, second = opened_poses(picked.folder / "08")
    np.testing.assert_array_equal(first, [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_array_equal(second[:3, 3], [5, -7, 1])


def test_registered_scans_are_seen_from_their_sensor_and_lie_where_they_are_in_the_map(picked):
    """Their points are in the frame of the map already; the tool hides those beyond 50 m."""
    origins = {"08/000010": (300.0, 20.0, 1.5), "08/000011": (310.0, 25.0, 1.5)}
    origins["09/000010"] = (7.0, 0.0, 0.0)
    (picked.root / "sequences/08/poses.txt").write_text("0 -1 0 300 1 0 0 20 0 0 1 1.5\n" * 2)
    sensor = replace(SMALL, registered=True)
    picked.write(SensorPositions(sensor=sensor, origins=origins))
    poses = opened_poses(picked.folder / "08")
    for (sequence, stem), pose in zip(picked.scans[:2], poses, strict=True):
        points = read_scan(picked.folder / sequence / "velodyne" / f"{stem}.bin").points
        in_map = picked.points((sequence, stem)) - np.float32(origins["08/000010"])
        np.testing.assert_allclose(points @ pose[:3, :3].T + pose[:3, 3], in_map, atol=1e-4)
        nearest = picked.points((sequence, stem)) - np.float32(origins[f"{sequence}/{stem}"])
        np.testing.assert_allclose(points, nearest, atol=1e-4)


def test_registered_scans_of_two_frames_lie_where_they_are_in_the_map(picked):
    """Two scans 4 m apart, on both sides of the border of two frames."""
    origins = {"08/000010": (4998.0, 20.0, 1.5), "08/000011": (-4998.0, 20.0, 1.5)}
    origins["09/000010"] = (7.0, 0.0, 0.0)
    frames = {"000010": (690_000.0, 0.0, 0.0), "000011": (700_000.0, 0.0, 0.0)}
    (picked.root / "sequences/08" / FRAMES).write_bytes(encode_frames(frames))
    picked.write(SensorPositions(sensor=replace(SMALL, registered=True), origins=origins))
    first, second = opened_poses(picked.folder / "08")
    np.testing.assert_array_equal([first[:3, 3], second[:3, 3]], [[0, 0, 0], [4, 0, 0]])


def test_points_without_a_measurement_stay_at_the_origin_of_a_scan():
    scan = make_scan(20)
    scan.points[5:9] = 0
    labelled = LabelledPoints(
        sequence="08", stem="a", scan=scan, labels=np.zeros(20, "u4"), origin=(300.0, 20.0, 1.5)
    )
    content = PointLabeler().scan_files(labelled, SPACE)["08/velodyne/a.bin"]
    points = np.frombuffer(content, "<f4").reshape(-1, 4)[:, :3]
    np.testing.assert_array_equal(~points.any(axis=1), ~scan.points.any(axis=1))
    assert np.flatnonzero(~points.any(axis=1)).tolist() == [5, 6, 7, 8]


def test_names_with_dots_have_files_that_the_tool_pairs(picked):
    """It names the label file of a scan by the name up to its first dot."""
    sequence = picked.root / "sequences/09"
    for folder in ("velodyne", "labels"):
        (path,) = (sequence / folder).iterdir()
        path.rename(path.with_name(f"1700.25{path.suffix}"))
    picked.scans[2] = scan = ("09", "1700.25")
    picked.before[scan] = picked.labels(scan)
    picked.write()
    path = picked.folder / "09/labels/1700_25.label"
    assert (picked.folder / "09/velodyne/1700_25.bin").is_file()
    path.write_bytes(picked.corrected(scan).astype("<u4").tobytes())
    found = picked.import_from(path, overwrite=True)
    assert (found.failures, [entry.scan for entry in found.scans]) == ([], ["09/1700.25"])
    np.testing.assert_array_equal(picked.labels(scan), picked.corrected(scan))


def rename(picked, number, stem):
    """Give a scan of the data set another stem."""
    sequence, old = picked.scans[number]
    for suffix, folder in ((".bin", "velodyne"), (".label", "labels")):
        path = picked.root / "sequences" / sequence / folder / f"{old}{suffix}"
        path.rename(path.with_name(f"{stem}{suffix}"))
    picked.scans[number] = (sequence, stem)
    picked.before[sequence, stem] = picked.before.pop((sequence, old))


def test_labels_come_back_to_the_scan_with_a_dot_beside_one_without(picked):
    """Both have as many points, so that only the names tell them apart."""
    rename(picked, 0, "1")
    rename(picked, 1, "1.5")
    picked.write()
    scan = ("08", "1.5")
    path = picked.folder / "08/labels/1_5.label"
    path.write_bytes(picked.corrected(scan).astype("<u4").tobytes())
    found = picked.import_from(picked.folder, overwrite=True)
    assert "08/1.5" in {entry.scan for entry in found.scans}
    np.testing.assert_array_equal(picked.labels(scan), picked.corrected(scan))
    np.testing.assert_array_equal(picked.labels(("08", "1")), picked.before["08", "1"])


def test_scans_with_one_name_in_the_tool_are_refused_before_a_file_is_written(picked):
    rename(picked, 0, "a.b")
    rename(picked, 1, "a_b")
    refused(UsageError, "tool point-labeler", picked.write)
    assert not picked.folder.exists()


def test_label_files_are_of_the_tool_only_in_its_folder(picked, tmp_path):
    picked.write()
    path = picked.folder / "08/labels/000011.label"
    elsewhere = tmp_path / "edited/08/000011.label"
    elsewhere.parent.mkdir(parents=True)
    elsewhere.write_bytes(picked.corrected(SCAN).astype("<u4").tobytes())
    for edited, tool in ((elsewhere, ""), (path, "point-labeler")):
        (scan,) = picked.import_from(edited, overwrite=True).scans
        assert scan.tool == tool


def test_poses_are_in_the_order_of_the_files():
    """`a-b.bin` comes before `a.bin`, but `a` before `a-b`."""
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 0, 3] = [0, 5]
    files = PointLabeler().sequence_files("08", ("a", "a-b"), poses)
    rows = [line.split() for line in files["08/poses.txt"].decode().splitlines()]
    assert [float(row[3]) for row in rows] == [0, -5]


def test_unreadable_poses_are_skipped_with_a_warning(picked, caplog):
    poses = picked.root / "sequences/08/poses.txt"
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 zero\n" * 2)
    picked.write()
    assert str(poses) in caplog.text
    assert opened_poses(picked.folder / "08")[1][0, 3] == APART_M


def test_three_labels_changed_in_place_come_back_exactly(picked):
    picked.write()
    path = picked.folder / "08/labels/000011.label"
    path.write_bytes(picked.corrected(SCAN).astype("<u4").tobytes())
    found = picked.import_from(picked.folder)
    assert [scan.scan for scan in found.scans] == ["08/000011"]
    assert (len(found.unedited), found.failures) == (2, [])
    np.testing.assert_array_equal(picked.labels(SCAN), picked.corrected(SCAN))
    assert (picked.labels(SCAN) != picked.before[SCAN]).sum() == 3


def test_the_same_command_again_keeps_edited_labels(picked):
    picked.write()
    path = picked.folder / "08/labels/000011.label"
    path.write_bytes(picked.corrected(SCAN).astype("<u4").tobytes())
    (picked.folder / "09/poses.txt").unlink()
    edited = files_below(picked.folder)
    picked.write()
    again = files_below(picked.folder)
    assert again.keys() - edited.keys() == {"09/poses.txt"}
    assert {name: again[name] for name in edited} == edited


def test_poses_follow_the_scans_unless_they_were_edited(picked, caplog):
    """A scan that is added before others moves the lines of their poses."""
    picked.write()
    path = picked.folder / "08/poses.txt"
    both = path.read_bytes()
    lines = both.splitlines(keepends=True)
    scans = sorted((picked.folder / "08/velodyne").iterdir())
    assert len(lines) == len(scans) == 2
    stem = scans[0].stem
    points = picked.root / f"sequences/08/velodyne/{stem}.bin"
    hidden = points.rename(points.with_suffix(".hidden"))
    path.unlink()
    picked.write()
    assert len(path.read_bytes().splitlines()) == 1
    hidden.rename(points)
    picked.write()
    assert path.read_bytes() == both
    path.write_bytes(lines[0])
    picked.write()
    assert path.read_bytes() == lines[0]
    assert str(path) in caplog.text


def test_a_label_file_of_another_scan_is_refused(picked):
    picked.write()
    path = picked.folder / "08/labels/000011.label"
    path.write_bytes(b"\n\0\0\0" * 7)
    (failure,) = picked.import_from(path).failures
    assert failure.code == "label"
    np.testing.assert_array_equal(picked.labels(SCAN), picked.before[SCAN])
