# SPDX-License-Identifier: MIT
"""Recordings of Ouster sensors: `.pcap` with its metadata `.json` beside it, and `.osf`."""

import logging
import subprocess
import sys
import weakref
from pathlib import Path
from threading import Lock

from salsanext_cli.core.errors import FormatError, NoInputError
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.io.files.reading import reading, refusing_damage
from salsanext_cli.io.formats.columns import Columns
from salsanext_cli.io.formats.packets import is_cut

EXPECTED = "a recording of Ouster sensors"
HINT = "put the metadata of the sensor beside a .pcap, as a .json of the same name"
REWRITE = "rewrite it with a newer ouster-sdk, or convert it"
PROBE_TIMEOUT_S = 600
PROBE = "import sys; from ouster.sdk import open_source; open_source(sys.argv[1], collate=False)"
NS_PER_PCAP_TIME = 1000

log = logging.getLogger(__name__)


class OusterRecording:
    """Recording of one or more Ouster sensors, which are its topics, as in bags."""

    def __init__(self, path: Path) -> None:
        import_extra("ouster.sdk", "ouster")
        from ouster.sdk import open_source

        self.path = path
        self._lock = Lock()
        is_pcap = path.suffix.lower() == ".pcap"
        with reading(path) as file:
            if is_pcap and is_cut(file):
                log.warning("%s: cut off within a packet: its last scan is incomplete", path)
        if not is_pcap:
            _probe(path)
        with refusing_damage(path, EXPECTED, HINT):
            try:
                self._source = open_source(str(path), collate=False, index=True)
            except Exception as error:
                if "Duplicate" in str(error):
                    problem = "has several sensors on one port"
                    expected = "a port for each sensor"
                    raise FormatError(path, problem, expected, "record them again") from error
                raise
            unit = NS_PER_PCAP_TIME if is_pcap else 1
            profiles = [str(info.format.udp_profile_lidar) for info in self._source.sensor_info]
            self._times = {  # A disabled sensor may still have frames of its IMU.
                f"sensor{number}": [int(t) * unit for t in index[:, 0] if profiles[number] != "OFF"]
                for number, index in enumerate(self._source.individual_index)
            }
        weakref.finalize(self, self._source.close)

    def cloud_topics(self) -> list[str]:
        """Return the sensors with frames, sorted."""
        return sorted(name for name, times in self._times.items() if times)

    def without_clouds(self) -> NoInputError:
        """Return the error of a recording without packets of points."""
        return NoInputError(self.path, "has no LiDAR packets", "packets with distances")

    def scan_keys(self, topic: str) -> list[int]:
        """Return the times of the frames of a sensor in nanoseconds, sorted."""
        return sorted(self._times[topic])

    def point_count(self, topic: str) -> int:
        """Return the number of rays in a frame of a sensor."""
        form = self._source.sensor_info[list(self._times).index(topic)].format
        return int(form.pixels_per_column * form.columns_per_frame)

    def poses(self) -> None:
        """Return None: poses in recordings are not read."""

    def columns(self, topic: str, key: int, number: int, path: Path) -> Columns:
        """Read the first returns of a frame, as `Bag.columns`; rays without one are at 0."""
        from ouster.sdk.core import XYZLut

        places = [place for place, at in enumerate(self._times[topic]) if at == key]
        if number >= len(places):
            raise FormatError(path, "no such scan", "a scan that the recording lists")
        with refusing_damage(path, EXPECTED, HINT), self._lock:
            frames = self._source.single(list(self._times).index(topic))
            try:
                frame = frames[places[number]][0]
            except IndexError as error:
                problem = "has a scan with a wrong checksum"
                raise FormatError(path, problem, EXPECTED, REWRITE) from error
            distances = frame.field("RANGE")
            reflectivity = frame.field("REFLECTIVITY")
            if distances.any() and not reflectivity[distances > 0].any():
                problem = "has only reflectivities of 0, so it is not decoded correctly"
                raise FormatError(path, problem, EXPECTED, REWRITE)
            points = XYZLut(frame.sensor_info)(distances) * (distances > 0)[..., None]
            columns = {axis: points[..., n].ravel() for n, axis in enumerate("xyz")}
            return columns | {"reflectivity": reflectivity.ravel()}


def _probe(path: Path) -> None:
    """Open a recording in another process, which the library kills if the file is damaged."""
    command = [sys.executable, "-c", PROBE, str(path)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PROBE_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        problem = f"cannot be opened within {PROBE_TIMEOUT_S} s"
        raise FormatError(path, problem, "an OSF file") from error
    if done.returncode < 0:
        raise FormatError(path, "is damaged: ouster-sdk crashes", "an OSF file", "copy it again")
