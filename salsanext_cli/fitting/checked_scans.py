# SPDX-License-Identifier: MIT
"""Scans read, checked and projected: the first steps of the stages that project one."""

from salsanext_cli.fitting.findings import ScanCheck
from salsanext_cli.fitting.scan_checks import check_scan
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.projection import project
from salsanext_cli.records import RangeImage
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.sensors.sensor import Sensor


def project_checked(
    file: ScanFile, sensor: Sensor, device: str = "cpu", trained: Sensor | None = None
) -> tuple[RangeImage, ScanCheck]:
    """Read, check and project a scan; return its range image and what the check found.

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
    check = check_scan(file.path, scan, sensor, trained)
    return project(scan, sensor, device), check
