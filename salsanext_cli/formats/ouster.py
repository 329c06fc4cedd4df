# SPDX-License-Identifier: MIT
"""Recordings of Ouster sensors: `.pcap` with its metadata `.json` beside it, and `.osf`."""

import logging
import struct
import subprocess
import sys
import weakref
from io import BufferedReader
from pathlib import Path
from threading import Lock

from salsanext_cli.errors import FormatError
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.files.reading import reading, refusing_damage, size_of
from salsanext_cli.formats.columns import Columns

EXPECTED = "a recording of Ouster sensors"
REMEDY = "put the metadata of the sensor beside a .pcap, as a .json of the same name"
REWRITE = "write it again with a newer ouster-sdk, or convert it"
PROBE_TIMEOUT_S = 600
PROBE = "import sys; from ouster.sdk import open_source; open_source(sys.argv[1], collate=False)"
PCAP_BYTE_ORDER = {
    **dict.fromkeys((b"\xd4\xc3\xb2\xa1", b"\x4d\x3c\xb2\xa1"), "<"),
    **dict.fromkeys((b"\xa1\xb2\xc3\xd4", b"\xa1\xb2\x3c\x4d"), ">"),
}
"""Byte order of a packet's header by the first bytes of the file."""
NS_PER_PCAP_TIME = 1000
KIND = "Ouster"

log = logging.getLogger(__name__)


class OusterRecording:
    """Recording of one or more Ouster sensors, which are its topics, as bags have them."""

    def __init__(self, path: Path) -> None:
        import_extra("ouster.sdk", "ouster")
        from ouster.sdk import open_source

        self.path, self._lock = path, Lock()
        is_pcap = path.suffix.lower() == ".pcap"
        with reading(path) as file:
            if is_pcap and _is_cut(file):
                log.warning("%s: cut off within a packet: its last scan is not whole", path)
        if not is_pcap:
            _probe(path)
        with refusing_damage(path, EXPECTED, REMEDY):
            try:
                self._source = open_source(str(path), collate=False, index=True)
            except Exception as error:
                if "Duplicate" in str(error):
                    found, expected = "several sensors send to one port", "a port for each"
                    raise FormatError(path, found, expected, "record them again") from error
                raise
            unit = NS_PER_PCAP_TIME if is_pcap else 1
            profiles = [str(info.format.udp_profile_lidar) for info in self._source.sensor_info]
            self._times = {  # A sensor that is off may have frames of its IMU.
                f"sensor{number}": [int(t) * unit for t in index[:, 0] if profiles[number] != "OFF"]
                for number, index in enumerate(self._source.individual_index)
            }
        weakref.finalize(self, self._source.close)

    def topics(self) -> dict[str, str]:
        """Return the sensors that have frames, as topics of a kind."""
        return {name: KIND for name, times in self._times.items() if times}

    def clouds(self) -> list[str]:
        """Return the sensors that have frames."""
        return [*self.topics()]

    def times(self, topic: str) -> list[int]:
        """Return the times of the frames of a sensor in nanoseconds, sorted."""
        return sorted(self._times[topic])

    def columns(self, topic: str, time: int, number: int, path: Path) -> Columns:
        """Read the first returns of a frame, as `Bag.columns`; at the origin where is none."""
        from ouster.sdk.core import XYZLut

        places = [place for place, each in enumerate(self._times[topic]) if each == time]
        if number >= len(places):
            raise FormatError(path, "not there", "a scan that the recording lists")
        with refusing_damage(path, EXPECTED, REMEDY), self._lock:
            of_sensor = self._source.single([*self._times].index(topic))
            try:
                frame = of_sensor[places[number]][0]
            except IndexError as error:
                found = "a scan cannot be read: its checksum is wrong"
                raise FormatError(path, found, EXPECTED, REWRITE) from error
            distances, reflectivity = frame.field("RANGE"), frame.field("REFLECTIVITY")
            if distances.any() and not reflectivity[distances > 0].any():
                found = "reflectivities that are all 0, as of a field that cannot be decoded"
                raise FormatError(path, found, EXPECTED, REWRITE)
            points = XYZLut(frame.sensor_info)(distances) * (distances > 0)[..., None]
            columns = {axis: points[..., n].ravel() for n, axis in enumerate("xyz")}
            return columns | {"reflectivity": reflectivity.ravel()}


def _is_cut(file: BufferedReader) -> bool:
    """Say whether a file of packets ends within one."""
    size, order = size_of(file), PCAP_BYTE_ORDER.get(file.read(4))
    place = file.seek(24)
    while order and place < size:
        head = file.read(16)
        if len(head) == 16:
            place += 16 + struct.unpack(f"{order}8xI4x", head)[0]
            file.seek(place)
        if len(head) < 16 or place > size:
            return True
    return False


def _probe(path: Path) -> None:
    """Open a recording in a process of its own first, which the library ends if it is damaged."""
    command = [sys.executable, "-c", PROBE, str(path)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise FormatError(path, f"not opened in {PROBE_TIMEOUT_S} s", "an OSF file") from error
    if done.returncode < 0:
        raise FormatError(path, "damaged: ouster-sdk crashes at it", "an OSF file", "copy it again")
