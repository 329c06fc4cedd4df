# SPDX-License-Identifier: MIT
"""Recordings of an Ouster sensor that ouster-sdk wrote."""

import numpy as np
import pytest

pytest.importorskip("ouster.sdk")

from ouster_recordings import START, STEP, write_recording

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError, NoInputError, SalsanextError
from salsanext_cli.runs.scans.scan_search import find_scans

TIMES = [f"{START + n * STEP}" for n in range(4)]


@pytest.fixture(params=[".osf", ".pcap"])
def recording(request, tmp_path):
    return write_recording(tmp_path / f"drive{request.param}", len(TIMES))


def test_the_scans_are_the_frames_named_by_their_times(recording):
    scans = find_scans(recording)
    assert [(scan.sequence, scan.stem) for scan in scans] == [("drive", time) for time in TIMES]
    assert scans[0].path == recording / "sensor0" / TIMES[0]
    for number in (2, 0, 3, 1):
        scan = read_scan(scans[number].path)
        points, intensity = scan.points.reshape(64, 512, 3), scan.intensity.reshape(64, 512)
        distances = np.linalg.norm(points - [0, 0, 0.03618], axis=2)
        # The origin of a beam lies up to 28 mm beside the axis.
        np.testing.assert_allclose(distances[:, ::2], 5 + number, atol=0.03)
        assert not points[:, 1::2].any()
        np.testing.assert_allclose(intensity[0], np.arange(512) % 256 / 255, atol=1e-6)


def test_a_recording_that_was_cut_is_an_error_or_a_warning(recording, caplog):
    data = recording.read_bytes()
    recording.write_bytes(data[: len(data) * 2 // 3])
    if recording.suffix == ".osf":
        with pytest.raises(SalsanextError, match=r"drive\.osf"):
            find_scans(recording)
        return
    scans = find_scans(recording)
    assert [scan.stem for scan in scans] == TIMES[: len(scans)]
    assert "cut off within a packet" in caplog.text


def test_damaged_recordings_are_refused(recording):
    for content in (b"", b"x" * 5000):
        recording.write_bytes(content)
        with pytest.raises(SalsanextError, match=recording.name):
            find_scans(recording)


def test_packets_without_metadata_are_refused(recording):
    if recording.suffix == ".pcap":
        recording.with_suffix(".json").unlink()
        with pytest.raises(FormatError) as caught:
            find_scans(recording)
        assert ".json" in caught.value.hint


def test_a_file_that_crashes_the_library_is_one_error(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "salsanext_cli.io.formats.ouster.PROBE", "import os; os.kill(os.getpid(), 11)"
    )
    path = tmp_path / "drive.osf"
    path.write_bytes(b"x")
    with pytest.raises(FormatError, match="crashes"):
        find_scans(path)


@pytest.mark.parametrize("suffix", [".osf", ".pcap"])
def test_reflectivities_that_were_not_decoded_are_refused(tmp_path, suffix):
    (scan,) = find_scans(write_recording(tmp_path / f"drive{suffix}", 1, brightest=0))
    with pytest.raises(FormatError, match="reflectivities of 0"):
        read_scan(scan.path)


def test_packets_of_no_lidar_are_named(tmp_path):
    path = write_recording(tmp_path / "drive.pcap", 1)
    path.write_bytes(path.read_bytes()[:24])
    with pytest.raises(NoInputError, match="no LiDAR packets") as caught:
        find_scans(path)
    assert "PointCloud2" not in str(caught.value)


@pytest.mark.real
def test_reported_recordings_are_refused_by_what_they_are(real_data):
    for name, problem in {
        "bad_encoding.osf": "reflectivities of 0",
        "bad_crc32.osf": "wrong checksum",
        "imu_zm_no_lidar.pcap": "no LiDAR packets",
        "same_ports.pcap": "several sensors on one port",
    }.items():
        with pytest.raises(SalsanextError, match=problem):
            [read_scan(scan.path) for scan in find_scans(real_data / "data/reported/ouster" / name)]
