# SPDX-License-Identifier: MIT
"""Captures of the packets of Velodyne sensors, decoded by `velodyne-decoder`."""

import logging
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from salsanext_cli.errors import FormatError, NoInputError
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.files.reading import reading, refusing_damage
from salsanext_cli.formats.captures import VELODYNE_BYTES
from salsanext_cli.formats.columns import Columns
from salsanext_cli.formats.packets import is_cut, udp_packets

EXPECTED = "a capture of Velodyne sensors"
REVOLUTION_ENDS_DEG = 20.0  # A new revolution begins where the azimuth falls by more
AZIMUTHS_PER_DEG = 100

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Revolution:
    """Packets of a revolution of a sensor."""

    time_ns: int  # Of its first packet
    times_s: list[float] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)  # Of the packets in the file


class VelodyneCapture:
    """Capture of one or more Velodyne sensors, which are its topics, as in bags."""

    def __init__(self, path: Path) -> None:
        decoder = import_extra("velodyne_decoder", "velodyne")
        self.path = path
        self._lock = Lock()
        with reading(path) as file:
            if is_cut(file):
                log.warning("%s: cut off within a packet: its last scan is incomplete", path)
        self._revolutions = _revolutions(path)
        self._config = _configuration(decoder, path)
        self._file = path.open("rb")
        weakref.finalize(self, self._file.close)

    def cloud_topics(self) -> list[str]:
        """Return the sensors with packets, sorted."""
        return sorted(self._revolutions)

    def without_clouds(self) -> NoInputError:
        """Return the error of a recording without packets of points."""
        return NoInputError(self.path, "has no LiDAR packets", "packets with distances")

    def times(self, topic: str) -> list[int]:
        """Return the times of the revolutions of a sensor in nanoseconds, sorted."""
        return sorted(revolution.time_ns for revolution in self._revolutions[topic])

    def point_count(self, topic: str) -> int:
        """Return the number of points of a revolution in the middle."""
        times = self.times(topic)
        return len(self.columns(topic, times[len(times) // 2], 0, self.path)["x"])

    def columns(self, topic: str, time: int, number: int, path: Path) -> Columns:
        """Read the points of a revolution, as `Bag.columns`; both returns, if there are two."""
        revolutions = self._revolutions[topic]
        at_time = [revolution for revolution in revolutions if revolution.time_ns == time]
        if number >= len(at_time):
            raise FormatError(path, "no such scan", "a scan that the recording lists")
        with refusing_damage(path, EXPECTED), self._lock:
            points = self._decoded(at_time[number])
        columns = {name: points[name] for name in "xyz"}
        return columns | {"intensity": np.rint(points["intensity"]).astype(np.uint8)}

    def _decoded(self, revolution: Revolution) -> Any:
        """Return the points of a revolution, a structured array (N,)."""
        decoder = import_extra("velodyne_decoder", "velodyne")
        packets = decoder.PacketVector()
        for time, offset in zip(revolution.times_s, revolution.offsets, strict=True):
            self._file.seek(offset)
            packets.append(decoder.VelodynePacket(time, self._file.read(VELODYNE_BYTES)))
        _, points = decoder.ScanDecoder(self._config).decode(packets, as_pcl_structs=True)
        return points


def _configuration(decoder: Any, path: Path) -> Any:
    """Return the settings to decode a capture with."""
    with refusing_damage(path, EXPECTED):
        try:
            # The lasers of an HDL-64E are calibrated one by one; its packets contain the values.
            model, calibration = decoder.hdl64e.detect_hdl64e(str(path))
        except ValueError as error:
            problem = "is of an HDL-64E, and contains only a part of its calibration"
            hint = "record at least two seconds"
            raise FormatError(path, problem, EXPECTED, hint) from error
        return decoder.Config(model=model, calibration=calibration)


def _revolutions(path: Path) -> dict[str, list[Revolution]]:
    """Return the revolutions of each sensor, by its topic."""
    by_sensor: dict[tuple[bytes, int], list[Revolution]] = {}
    azimuths: dict[tuple[bytes, int], int] = {}
    with reading(path) as file:
        for packet in udp_packets(file):
            if packet.size != VELODYNE_BYTES or len(packet.payload) != VELODYNE_BYTES:
                continue
            sensor = (packet.source, packet.port)
            azimuth = int.from_bytes(packet.payload[2:4], "little")
            fall = azimuths.get(sensor, azimuth) - azimuth
            azimuths[sensor] = azimuth
            revolutions = by_sensor.setdefault(sensor, [])
            if not revolutions or fall > REVOLUTION_ENDS_DEG * AZIMUTHS_PER_DEG:
                revolutions.append(Revolution(packet.time_ns))
            revolutions[-1].times_s.append(packet.time_ns / 1e9)
            revolutions[-1].offsets.append(packet.offset)
    ordered: Sequence[tuple[bytes, int]] = sorted(by_sensor)
    return {f"sensor{number}": by_sensor[sensor] for number, sensor in enumerate(ordered)}
