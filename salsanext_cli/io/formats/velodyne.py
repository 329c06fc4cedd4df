# SPDX-License-Identifier: MIT
"""Captures of the packets of Velodyne sensors, decoded by `velodyne-decoder`."""

import logging
import warnings
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import yaml

from salsanext_cli.core.errors import FormatError, NoInputError
from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.texts import counted, error_text
from salsanext_cli.io.files.reading import reading, refusing_damage
from salsanext_cli.io.formats.captures import VELODYNE_BYTES
from salsanext_cli.io.formats.columns import Columns
from salsanext_cli.io.formats.packets import UdpPacket, is_cut, udp_packets

EXPECTED = "a capture of Velodyne sensors"
REVOLUTION_ENDS_DEG = 20.0  # A new revolution begins where the azimuth falls by more
AZIMUTHS_PER_DEG = 100
MIN_SPAN = 0.9  # Least share of the largest angle that a revolution of the sensor spans
PROBED_PACKETS = 5  # Of a sensor, whose last bytes show whether it is an HDL-64E

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Revolution:
    """Packets of a revolution of a sensor."""

    time_ns: int  # Of its first packet
    azimuths: list[int] = field(default_factory=list)  # Of the packets, in hundredths of a degree
    times_s: list[float] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)  # Of the packets in the file

    @property
    def span(self) -> int:
        """Angle from the first to the last packet in hundredths of a degree."""
        return self.azimuths[-1] - self.azimuths[0]


class VelodyneCapture:
    """Capture of one or more Velodyne sensors, which are its topics, as in bags."""

    def __init__(self, path: Path) -> None:
        decoder = import_extra("velodyne_decoder", "velodyne")
        self.path = path
        self._lock = Lock()
        with reading(path) as file:
            if is_cut(file):
                log.warning("%s: cut off within a packet: its last scan is incomplete", path)
        by_sensor = {
            sensor: _whole_revolutions(revolutions, path)
            for sensor, revolutions in _revolutions(path).items()
        }
        topics = {f"sensor{number}": sensor for number, sensor in enumerate(sorted(by_sensor))}
        self._revolutions = {topic: by_sensor[sensor] for topic, sensor in topics.items()}
        self._configs = {
            topic: _configuration(decoder, path, sensor) for topic, sensor in topics.items()
        }
        self._file = path.open("rb")
        weakref.finalize(self, self._file.close)

    def cloud_topics(self) -> list[str]:
        """Return the sensors with packets, sorted."""
        return sorted(self._revolutions)

    def without_clouds(self) -> NoInputError:
        """Return the error of a recording without packets of points."""
        return NoInputError(self.path, "has no LiDAR packets", "packets with distances")

    def scan_keys(self, topic: str) -> list[int]:
        """Return the times of the revolutions of a sensor in nanoseconds, sorted."""
        return sorted(revolution.time_ns for revolution in self._revolutions[topic])

    def point_count(self, topic: str) -> int:
        """Return the number of points of a revolution in the middle."""
        times = self.scan_keys(topic)
        return len(self.columns(topic, times[len(times) // 2], 0, self.path)["x"])

    def poses(self) -> None:
        """Return None: packets state no poses."""

    def columns(self, topic: str, key: int, number: int, path: Path) -> Columns:
        """Read the points of a revolution, as `Bag.columns`; both returns, if there are two."""
        revolutions = self._revolutions[topic]
        at_time = [revolution for revolution in revolutions if revolution.time_ns == key]
        if number >= len(at_time):
            raise FormatError(path, "no such scan", "a scan that the recording lists")
        with refusing_damage(path, EXPECTED), self._lock:
            points = self._decoded(topic, at_time[number], path)
        columns = {name: points[name] for name in "xyz"}
        return columns | {"intensity": np.rint(points["intensity"]).astype(np.uint8)}

    def _decoded(self, topic: str, revolution: Revolution, path: Path) -> Any:
        """Return the points of a revolution, a structured array (N,); `path` is for errors."""
        decoder = import_extra("velodyne_decoder", "velodyne")
        packets = decoder.PacketVector()
        for time, offset in zip(revolution.times_s, revolution.offsets, strict=True):
            self._file.seek(offset)
            packets.append(decoder.VelodynePacket(time, self._file.read(VELODYNE_BYTES)))
        try:
            _, points = decoder.ScanDecoder(self._configs[topic]).decode(packets, True)
        except RuntimeError as error:
            raise FormatError(path, f"cannot be decoded: {error_text(error)}", EXPECTED) from error
        return points


def _packets_of_points(path: Path) -> Iterator[UdpPacket]:
    """Yield the whole packets with points of all sensors of a capture."""
    with reading(path) as file:
        for packet in udp_packets(file):
            if packet.size == len(packet.payload) == VELODYNE_BYTES:
                yield packet


def _sensor_of(packet: UdpPacket) -> tuple[bytes, int]:
    """Return what distinguishes the sensors of a capture: address and port."""
    return packet.source, packet.port


def _revolutions(path: Path) -> dict[tuple[bytes, int], list[Revolution]]:
    """Return the revolutions of each sensor of a capture."""
    by_sensor: dict[tuple[bytes, int], list[Revolution]] = {}
    azimuths: dict[tuple[bytes, int], int] = {}
    for packet in _packets_of_points(path):
        sensor = _sensor_of(packet)
        azimuth = int.from_bytes(packet.payload[2:4], "little")
        fall = azimuths.get(sensor, azimuth) - azimuth
        azimuths[sensor] = azimuth
        revolutions = by_sensor.setdefault(sensor, [])
        if not revolutions or fall > REVOLUTION_ENDS_DEG * AZIMUTHS_PER_DEG:
            revolutions.append(Revolution(time_ns=packet.time_ns))
        revolutions[-1].azimuths.append(azimuth)
        revolutions[-1].times_s.append(packet.time_ns / 1e9)
        revolutions[-1].offsets.append(packet.offset)
    return by_sensor


def _whole_revolutions(revolutions: list[Revolution], path: Path) -> list[Revolution]:
    """Return the revolutions of a sensor without the first and the last one if they are cut."""
    # A sensor that is set to a part of the circle spans no more in any revolution.
    least = MIN_SPAN * max(revolution.span for revolution in revolutions)
    whole = [
        revolution
        for number, revolution in enumerate(revolutions)
        if revolution.span >= least or 0 < number < len(revolutions) - 1
    ]
    cut = len(revolutions) - len(whole)
    if cut:
        notice_once(f"{path}: skipped at the ends: {counted(cut, 'incomplete revolution')}")
    return whole


def _configuration(decoder: Any, path: Path, sensor: tuple[bytes, int]) -> Any:
    """Return the settings to decode the packets of a sensor with.

    The lasers of an HDL-64E are calibrated one by one. Its packets contain the values, a byte in
    each, and therefore differ in the bytes that state the model of other sensors.
    """

    def payloads() -> Iterator[bytes]:
        packets = _packets_of_points(path)
        return (packet.payload for packet in packets if _sensor_of(packet) == sensor)

    models = [payload[-2:] for payload in islice(payloads(), PROBED_PACKETS)]
    if len(models) < PROBED_PACKETS or len({*models}) == 1:
        return decoder.Config()
    problem = "is of an HDL-64E, and contains only a part of its calibration"
    hint = "record at least two seconds"
    with refusing_damage(path, EXPECTED), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # The decoder warns of parts that it skips.
        try:
            status = decoder.hdl64e.read_status_info(payloads())
        except ValueError as error:
            raise FormatError(path, problem, EXPECTED, hint) from error
        if status["Calibration Time"] is None:
            raise FormatError(path, "is of an HDL-64E without its calibration", EXPECTED)
        is_s2 = status["Model"] == "S2"
        model = decoder.Model.HDL64E_S2 if is_s2 else decoder.Model.HDL64E_S3
        text = yaml.safe_dump(decoder.hdl64e.status_info_to_calib_dict(status))
        return decoder.Config(model=model, calibration=decoder.Calibration.from_string(text))
