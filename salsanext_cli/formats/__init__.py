# SPDX-License-Identifier: MIT
"""Readers and encoders of point files; scans are read by their suffixes."""

from pathlib import Path

from salsanext_cli.errors import FormatError
from salsanext_cli.formats import kitti, las, numpy_scans, text
from salsanext_cli.formats.columns import scan_of
from salsanext_cli.formats.pcd import pcd_columns
from salsanext_cli.formats.ply import ply_columns
from salsanext_cli.formats.recordings import read_recorded, recording_of
from salsanext_cli.records import Scan
from salsanext_cli.sensors.sensor import Sensor

CLOUD_SUFFIXES = (".pcd.bin", ".bin", ".pcd", ".ply", ".las", ".laz", ".xyz")
"""Suffixes of files that are scans wherever they lie; longer ones first: they decide the stem."""
TABLE_SUFFIXES = (".npy", ".npz", ".csv", ".txt")
"""Suffixes of files that often are something else, in the order in which a folder is searched."""
SCAN_SUFFIXES = (*CLOUD_SUFFIXES, *TABLE_SUFFIXES)
"""Suffixes of scans, upper or lower case."""


def scan_suffix(name: str) -> str:
    """Return the suffix that makes a file a scan, in lower case; empty if it is none."""
    return next((suffix for suffix in SCAN_SUFFIXES if name.lower().endswith(suffix)), "")


def read_scan(path: Path | str, sensor: Sensor | None = None) -> Scan:
    """Read a scan in the format that its suffix names, upper or lower case.

    Parameters
    ----------
    path : Path or str
        A file with one of the `SCAN_SUFFIXES`, or a scan of a recording as `find_scans` names it.
    sensor : Sensor, optional
        Its `intensity_scale` divides the intensity, except where the type of the values tells
        their range: bytes are divided by 255, those of LAS by 65535. Its `columns` name the
        columns of files that do not.

    Raises
    ------
    FormatError
        If the suffix is unknown or the file is not of that format.
    MissingDependency
        If the format needs a package that cannot be imported.
    """
    path = Path(path)
    scale = 1.0 if sensor is None else sensor.intensity_scale
    columns = () if sensor is None else sensor.columns
    match scan_suffix(path.name):
        case ".bin" | ".pcd.bin":
            return kitti.read_bin(path, columns=columns, intensity_scale=scale)
        case ".pcd":
            return scan_of(pcd_columns(path), path, scale)
        case ".ply":
            return scan_of(ply_columns(path), path, scale)
        case ".las" | ".laz":
            return las.read_las(path)
        case ".npy":
            return numpy_scans.read_npy(path, columns=columns, intensity_scale=scale)
        case ".npz":
            return numpy_scans.read_npz(path, columns=columns, intensity_scale=scale)
        case ".xyz" | ".csv" | ".txt":
            return text.read_text(path, columns=columns, intensity_scale=scale)
    if recording_of(path) not in (None, path):
        return read_recorded(path, scale)
    raise FormatError(path, "not a known scan format", f"a {', '.join(SCAN_SUFFIXES)} file")
