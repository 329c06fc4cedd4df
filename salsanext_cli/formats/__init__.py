# SPDX-License-Identifier: MIT
"""Readers and encoders of point files."""

from pathlib import Path

from salsanext_cli.errors import FormatError
from salsanext_cli.formats import kitti, pcd, ply
from salsanext_cli.formats.recordings.address import recording_of
from salsanext_cli.formats.recordings.recorded_scans import read_recorded
from salsanext_cli.records import Scan
from salsanext_cli.sensors import Sensor

SCAN_SUFFIXES = (".pcd.bin", ".bin", ".pcd", ".ply")
"""Suffixes of scans, upper or lower case; longer ones first, because they decide the stem."""


def scan_suffix(path: Path) -> str:
    """Return the suffix that makes a file a scan, in lower case; empty if it is none."""
    name = path.name.lower()
    return next((suffix for suffix in SCAN_SUFFIXES if name.endswith(suffix)), "")


def read_scan(path: Path | str, sensor: Sensor | None = None) -> Scan:
    """Read a scan in the format that its suffix names, upper or lower case.

    Parameters
    ----------
    path : Path or str
        A file with one of the `SCAN_SUFFIXES`, or a scan of a recording as `find_scans` names it.
    sensor : Sensor, optional
        Its `intensity_scale` divides the intensity, except where the file holds bytes: they are
        divided by 255.

    Raises
    ------
    FormatError
        If the suffix is unknown or the file is not of that format.
    """
    path = Path(path)
    intensity_scale = 1.0 if sensor is None else sensor.intensity_scale
    match scan_suffix(path):
        case ".bin" | ".pcd.bin":
            return kitti.read_bin(path, intensity_scale=intensity_scale)
        case ".pcd":
            return pcd.read_pcd(path, intensity_scale=intensity_scale)
        case ".ply":
            return ply.read_ply(path, intensity_scale=intensity_scale)
    if recording_of(path) not in (None, path):
        return read_recorded(path, intensity_scale)
    raise FormatError(path, "not a known scan format", f"a {', '.join(SCAN_SUFFIXES)} file")
