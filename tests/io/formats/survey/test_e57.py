# SPDX-License-Identifier: MIT
"""E57 files that pye57 wrote, compared with the arrays that it got."""

import sys

import numpy as np
import pytest
from e57_files import Station, write_e57, write_with_limits
from scans import make_scan, refused

from salsanext_cli import read_scan
from salsanext_cli.commands.stages.convert import convert
from salsanext_cli.core.errors import FormatError, MissingDependency, NoInputError
from salsanext_cli.io.formats import recordings
from salsanext_cli.io.formats.recordings import recorded_poses
from salsanext_cli.io.frames import read_frames
from salsanext_cli.io.poses import pose_readings
from salsanext_cli.runs.fit.pose_files import poses_beside, readings_of
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.scans.scan_search import find_scans

pye57 = pytest.importorskip("pye57")
SCANS = [make_scan(400, seed) for seed in range(3)]
STATIONS = [
    Station(scan.points.astype(np.float64), scan.intensity, 0.3 * n, (500_000 + 5 * n, 5.4e6, 312))
    for n, scan in enumerate(SCANS)
]


@pytest.fixture
def site(tmp_path):
    return write_e57(tmp_path / "site.e57", STATIONS)


def test_scans_are_those_of_a_drive_in_the_frames_of_their_sensors(site):
    files = find_scans(site)
    assert [file.name for file in files] == ["site/000000", "site/000001", "site/000002"]
    for file, expected in zip(files, SCANS, strict=True):
        scan = read_scan(file.path)
        np.testing.assert_allclose(scan.points, expected.points, atol=1e-6)
        np.testing.assert_array_equal(scan.intensity, expected.intensity)


def test_poses_are_those_of_pye57(site):
    poses = recorded_poses(site)
    file = pye57.E57(str(site))
    for number, pose in enumerate(poses):
        header = file.get_header(number)
        np.testing.assert_allclose(pose[:3, :3], header.rotation_matrix, atol=1e-12)
        np.testing.assert_array_equal(pose[:3, 3], header.translation)
        # Points in the frame of the site
        raw = file.read_scan(number, ignore_missing_fields=True)
        points = SCANS[number].points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(points[:, 0], raw["cartesianX"], atol=1e-5)
    files = find_scans(site)
    assert poses_beside(files) == site
    (reading,) = readings_of(site, files[1:])
    np.testing.assert_array_equal(reading, poses[1:])


def test_a_site_becomes_a_sequence_with_poses(site, tmp_path):
    folder = tmp_path / "data"
    assert convert(site, folder).done == 3
    place = folder / "sequences/site"
    assert not (place / "times.txt").exists()
    names = [file.stem for file in find_scans(folder)]
    (poses,) = pose_readings(place / "poses.txt", names, names)
    np.testing.assert_allclose(poses, recorded_poses(site), atol=1e-12)


def test_points_without_a_measurement_keep_their_place(tmp_path):
    invalid = np.arange(400) % 3 == 0
    station = Station(STATIONS[0].points, SCANS[0].intensity, invalid=invalid)
    path = write_e57(tmp_path / "a.e57", [station])
    (file,) = find_scans(path)
    np.testing.assert_array_equal(np.isnan(read_scan(file.path).points).all(axis=1), invalid)


def test_intensities_above_1_are_divided_by_their_limit(tmp_path):
    values = np.rint(SCANS[0].intensity * 2047).astype(np.float32)
    path = write_e57(tmp_path / "a.e57", [Station(STATIONS[0].points, values)])
    (file,) = find_scans(path)
    np.testing.assert_allclose(read_scan(file.path).intensity, values / values.max(), rtol=1e-6)


def test_limits_may_be_scaled_integers_as_the_intensities(tmp_path):
    path = write_with_limits(tmp_path / "a.e57", STATIONS[0].points, SCANS[0].intensity * 100)
    (file,) = find_scans(path)
    expected = np.rint(SCANS[0].intensity * 1000) / 1000
    np.testing.assert_allclose(read_scan(file.path).intensity, expected, atol=1e-6)


@pytest.mark.parametrize("inside", ["", "scans"])
def test_a_topic_of_a_site_is_converted_as_the_site(site, tmp_path, inside):
    folder = tmp_path / "data"
    assert convert(site / inside, folder).done == 3
    place = folder / "sequences/site"
    assert sorted(path.name for path in place.iterdir()) == [
        "convert.json",
        "poses.txt",
        "velodyne",
    ]


def test_the_frame_of_a_scan_in_a_map_is_written_beside_it(tmp_path):
    points = STATIONS[0].points + [500_123.0, 5_400_456.0, 300]
    path = write_with_limits(tmp_path / "a.e57", points, SCANS[0].intensity)
    folder = tmp_path / "data"
    assert convert(path, folder).done == 1
    assert convert(path, folder).skipped == 1
    place = folder / "sequences/a"
    assert sorted(p.name for p in place.iterdir()) == ["convert.json", "frames.json", "velodyne"]
    (frame,) = read_frames(place / "frames.json").values()
    (scan,) = find_scans(folder)
    assert np.abs(read_scan(scan.path).points + np.array(frame) - points).max() < 0.8e-3


def test_the_frame_of_a_scan_of_an_interrupted_run_is_written_later(tmp_path):
    points = STATIONS[0].points + [500_123.0, 5_400_456.0, 300]
    path = write_with_limits(tmp_path / "a.e57", points, SCANS[0].intensity)
    folder = tmp_path / "data"

    def interrupt(done, total):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        convert(path, folder, options=RunOptions(progress=interrupt))
    written = folder / "sequences/a/frames.json"
    assert not written.exists()
    assert convert(path, folder).skipped == 1
    frames = {"000000": (500_000.0, 5_400_000.0, 0.0)}
    assert read_frames(written) == frames
    written.write_bytes(b"")  # As a power cut leaves it
    convert(path, folder)
    assert read_frames(written) == frames


def test_identities_are_no_poses_and_rounded_map_coordinates_no_scan(tmp_path):
    points = STATIONS[0].points + [5e5, 5.4e6, 0]  # pye57 writes float32.
    path = write_e57(tmp_path / "a.e57", [Station(points)])
    assert recorded_poses(path) is None
    (file,) = find_scans(path)
    with pytest.raises(FormatError, match="map coordinates") as caught:
        read_scan(file.path)
    assert "double precision" in caught.value.hint


def test_damaged_empty_and_other_files_are_refused(site, tmp_path):
    content = site.read_bytes()
    path = tmp_path / "b.e57"
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 255
    for other in (
        content[:-1],
        content[: len(content) // 2],
        content[:40],
        bytes(flipped),
        b"ply\n",
    ):
        recordings._recording.cache_clear()
        path.write_bytes(other)
        with pytest.raises(FormatError, match="damaged or cut off") as caught:
            [read_scan(file.path) for file in find_scans(path)]
        assert "\n" not in caught.value.problem
        assert path.read_bytes() == other
    path.write_bytes(b"")
    assert refused(FormatError, path, find_scans, path).value.problem == "is empty"
    write_e57(path, [])
    refused(NoInputError, path, find_scans, path)


def test_unknown_scans_and_the_missing_package_are_named(site, monkeypatch):
    with pytest.raises(NoInputError, match="no such scan"):
        find_scans(site / "scans/000003")
    for name in ("000003", "-1", "000000_1", "first"):
        with pytest.raises(FormatError, match="no such scan"):
            read_scan(site / "scans" / name)
    recordings._recording.cache_clear()
    monkeypatch.setitem(sys.modules, "pye57", None)
    error = refused(MissingDependency, site, find_scans, site)
    assert "pye57" in error.value.problem
    assert "[e57]" in error.value.hint
