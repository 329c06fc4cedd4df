# SPDX-License-Identifier: MIT
"""Readers and encoders of point files; scans are read by their suffixes."""

from pathlib import Path

from salsanext_cli.errors import FormatError
from salsanext_cli.files.suffixes import SCAN_SUFFIXES
from salsanext_cli.formats.columns import scan_of
from salsanext_cli.formats.feather import feather_columns
from salsanext_cli.formats.kitti import read_bin
from salsanext_cli.formats.las import read_las
from salsanext_cli.formats.numpy_scans import npy_columns, npz_columns
from salsanext_cli.formats.pcd import pcd_columns
from salsanext_cli.formats.ply import ply_columns
from salsanext_cli.formats.recordings import recorded_columns, recording_of
from salsanext_cli.formats.text import text_columns
from salsanext_cli.records import Scan
from salsanext_cli.sensors.sensor import Sensor

NAMING_SUFFIXES = ("", ".pcd", ".ply", ".las", ".laz", ".feather")
"""Suffixes of formats with names of fields, which --columns does not change; of recordings none."""


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
    names = () if sensor is None else sensor.columns
    match scan_suffix(path.name):
        case ".bin" | ".pcd.bin" | ".bin.gz" | ".pcd.bin.gz":
            return read_bin(path, names, scale)
        case ".las" | ".laz":
            return read_las(path)
        case ".pcd":
            columns = pcd_columns(path)
        case ".ply":
            columns = ply_columns(path)
        case ".npy":
            columns = npy_columns(path, names)
        case ".npz":
            columns = npz_columns(path, names)
        case ".feather":
            columns = feather_columns(path)
        case ".xyz" | ".csv" | ".txt" | ".asc" | ".pts":
            columns = text_columns(path, names)
        case _ if recording_of(path) not in (None, path):
            columns = recorded_columns(path)
        case _:
            raise FormatError(path, "not a known scan format", f"a {', '.join(SCAN_SUFFIXES)} file")
    return scan_of(columns, path, scale)
