# SPDX-License-Identifier: MIT
"""Scans read, projected and checked: the first steps of every stage that looks at one."""

from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.coverage import field_of_view_coverage
from salsanext_cli.geometry.projection import project
from salsanext_cli.geometry.scan_checks import Finding, check_scan
from salsanext_cli.records import RangeImage
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile


def project_checked(
    file: ScanFile, sensor: Sensor, device: str = "cpu", trained: Sensor | None = None
) -> tuple[RangeImage, tuple[Finding, ...]]:
    """Read and project a scan; return its range image and what is doubtful about the scan.

    Parameters
    ----------
    file : ScanFile
    sensor : Sensor
        What the scan is projected for.
    device : str
        As `project` takes it.
    trained : Sensor, optional
        That of the weights, if a network is to label the scan.

    Raises
    ------
    FormatError
        If the file cannot be read, or holds no scan in metres around the sensor.
    """
    scan = read_scan(file.path, sensor)
    image, coverage = project(scan, sensor, device), field_of_view_coverage(scan, sensor)
    return image, check_scan(file.path, scan, image, sensor, coverage, trained)
