# SPDX-License-Identifier: MIT
"""Clouds of the packets of Velodyne's sensors."""

import sys

import numpy as np
import pytest
from captures import START_NS, STEP_NS, Sent, vlp16, vlp16_points, write_capture

from salsanext_cli import read_scan
from salsanext_cli.core.errors import FormatError, MissingDependency, UsageError
from salsanext_cli.core.notices import NOTICE, log_once
from salsanext_cli.io.formats.captures import VELODYNE, maker_of
from salsanext_cli.runs.scans.scan_search import find_scans

PACKET_DEG = 12 * 0.4


def drive(packets: int, seed: int = 0) -> list[tuple]:
    """Return the arguments of `vlp16` for some packets; 75 are a revolution."""
    random = np.random.default_rng(seed)
    return [
        (
            (number * PACKET_DEG) % 360,
            random.uniform(2, 80, (12, 32)) * (random.random((12, 32)) < 0.9),
            random.integers(0, 256, (12, 32)),
            number * STEP_NS // 1000,
        )
        for number in range(packets)
    ]


def payloads(measured: list[tuple]) -> list[bytes]:
    return [vlp16(*each) for each in measured]


def points_of(measured: list[tuple]) -> np.ndarray:
    return np.concatenate([vlp16_points(*each[:3]) for each in measured])


def require_points(scan, expected):
    """Compare points with the closed form, up to what the decoder rounds and the form leaves out.

    Azimuths are rounded to 0.01°, 7 mm at 80 m, and the offsets of the lasers are up to 11.2 mm.
    """
    order = np.lexsort(np.round(expected[:, :2], 2).T)
    found = np.column_stack([scan.points, scan.intensity * 255])
    assert len(found) == len(expected)
    # In both orders the lasers of a firing differ, so the nearest points are compared.
    distances = np.linalg.norm(found[:, None, :2] - expected[None, order, :2], axis=2)
    nearest = order[distances.argmin(axis=1)]
    assert len({*nearest.tolist()}) == len(found)
    np.testing.assert_allclose(found[:, :2], expected[nearest, :2], atol=0.007)
    np.testing.assert_allclose(found[:, 2], expected[nearest, 2], atol=0.0113)
    np.testing.assert_allclose(found[:, 3], expected[nearest, 3], atol=0.01)


def test_the_scans_of_a_velodyne_are_its_revolutions(tmp_path):
    pytest.importorskip("velodyne_decoder")
    measured = drive(150)
    path = write_capture(tmp_path / "drive.pcap", map(Sent, payloads(measured)))
    scans = find_scans(path)
    starts = [START_NS + number * STEP_NS for number in (0, 75)]
    assert [scan.stem for scan in scans] == [f"{start}" for start in starts]
    assert {scan.sequence for scan in scans} == {"drive"}
    counts = [np.count_nonzero(distances) for _, distances, _, _ in measured]
    assert [len(read_scan(scan.path)) for scan in scans] == [sum(counts[:75]), sum(counts[75:])]


def test_revolutions_that_are_cut_by_the_ends_of_the_capture_are_no_scans(tmp_path, caplog):
    pytest.importorskip("velodyne_decoder")
    log_once.cache_clear()
    caplog.set_level(NOTICE, "salsanext_cli")
    packets = payloads(drive(260))
    path = tmp_path / "drive.pcap"
    for first, last, starts, cut in (
        (50, 260, (75, 150), "2 incomplete revolutions"),
        (75, 230, (75, 150), "1 incomplete revolution"),
        (75, 225, (75, 150), ""),
        (10, 60, (10,), ""),
    ):
        caplog.clear()
        log_once.cache_clear()
        write_capture(path, map(Sent, packets[first:last]))
        stems = [scan.stem for scan in find_scans(path)]
        assert stems == [f"{START_NS + (number - first) * STEP_NS}" for number in starts]
        assert ("incomplete" in caplog.text) == bool(cut)
        assert cut in caplog.text


def test_a_sensor_that_is_set_to_a_part_of_the_circle_keeps_its_ends(tmp_path):
    pytest.importorskip("velodyne_decoder")
    packets = [payload for n, payload in enumerate(payloads(drive(225))) if 20 <= n % 75 < 50]
    path = write_capture(tmp_path / "drive.pcap", map(Sent, packets))
    assert len(find_scans(path)) == 3
    write_capture(path, map(Sent, packets[10:-10]))
    assert len(find_scans(path)) == 1


def test_the_points_of_a_short_capture_are_as_measured(tmp_path):
    pytest.importorskip("velodyne_decoder")
    measured = drive(5)
    path = write_capture(tmp_path / "drive.pcap", map(Sent, payloads(measured)))
    (scan,) = find_scans(path)
    require_points(read_scan(scan.path), points_of(measured))


def test_two_velodynes_in_one_capture_are_two_topics(tmp_path):
    pytest.importorskip("velodyne_decoder")
    front = drive(2)
    rear = drive(4, seed=1)
    packets = [Sent(payload, 2368) for payload in payloads(front)]
    packets += [Sent(payload, 2369) for payload in payloads(rear)]
    path = write_capture(tmp_path / "drive.pcap", packets)
    with pytest.raises(UsageError, match="2 topics") as caught:
        find_scans(path)
    assert caught.value.hint.endswith('/drive.pcap/sensor1"')
    for topic, measured in (("sensor0", front), ("sensor1", rear)):
        (scan,) = find_scans(path / topic)
        require_points(read_scan(scan.path), points_of(measured))


def test_damaged_packets_are_an_error_of_the_scan(tmp_path):
    pytest.importorskip("velodyne_decoder")
    packets = payloads(drive(15))
    packets[7] = packets[7][:-1] + b"\x99"  # The model of the sensor
    path = write_capture(tmp_path / "drive.pcap", map(Sent, packets))
    with pytest.raises(FormatError, match=r"drive\.pcap/sensor0.*cannot be decoded"):
        [read_scan(scan.path) for scan in find_scans(path)]


def test_a_capture_that_was_cut_is_a_warning(tmp_path, caplog):
    pytest.importorskip("velodyne_decoder")
    measured = drive(15)
    path = write_capture(tmp_path / "drive.pcap", map(Sent, payloads(measured)))
    path.write_bytes(path.read_bytes()[:-700])
    (scan,) = find_scans(path)
    assert "cut off within a packet" in caplog.text
    counts = [np.count_nonzero(distances) for _, distances, _, _ in measured]
    assert len(read_scan(scan.path)) == sum(counts[:-1])


def test_the_package_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "velodyne_decoder", None)
    path = write_capture(tmp_path / "drive.pcap", [Sent(b"\xff\xee" + bytes(1204))])
    with pytest.raises(MissingDependency, match="velodyne_decoder"):
        find_scans(path)


def hdl64(count):
    """Return packets of which the last bytes are those of a status, not of a model."""
    return [
        Sent(b"\xff\xee" + bytes(1202) + bytes([ord("HMSDNYGTV"[number % 9]), number % 200]), 2368)
        for number in range(count)
    ]


def test_an_hdl64_with_a_part_of_its_calibration_is_named(tmp_path):
    pytest.importorskip("velodyne_decoder")
    path = write_capture(tmp_path / "drive.pcap", hdl64(20))
    with pytest.raises(FormatError, match="part of its calibration") as caught:
        find_scans(path)
    assert "two seconds" in caught.value.hint


@pytest.mark.real
def test_the_reported_capture_is_read(real_data):
    path = real_data / "data/reported/round5/words/velodyne_vlp16.pcap"
    assert maker_of(path) == VELODYNE
    pytest.importorskip("velodyne_decoder")
    (file,) = find_scans(path)
    scan = read_scan(file.path)
    elevations = np.degrees(np.arcsin(scan.points[:, 2] / np.linalg.norm(scan.points, axis=1)))
    assert len(scan) > 10_000
    assert np.abs(elevations).max() < 17
