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

    `sensor`: what the scan is projected for; `device`: as `project` takes it; `trained`: that of
    the weights, if a network is to label the scan.
    """
    scan = read_scan(file.path, sensor)
    check = check_scan(file.path, scan, sensor, trained)
    return project(scan, sensor, device), check
