# SPDX-License-Identifier: MIT
"""Scans of files, read for the steps of `core.labelling` and of `core.labellers`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.scan_traits import MIN_TRAIT_POINTS
from salsanext_cli.core.labellers import Labeller
from salsanext_cli.core.labelling import PreparedScan, prepare_for, project_scan
from salsanext_cli.core.records import Origin, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.scans.scan_file import ScanFile


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedFile:
    """File of a scan, and its scan that is ready for a network."""

    file: ScanFile
    scan: PreparedScan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FileToLabel:
    """File of a scan, and its scan as a labeller or an estimator prepares it."""

    file: ScanFile
    scan: Any


def read_to_label(file: ScanFile, labeller: Labeller, origin: Origin | None = None) -> FileToLabel:
    """Read a scan and prepare it for a labeller; `origin` and errors are as of `read_prepared`."""
    scan = read_measured(file.path, labeller.network.sensor)
    return FileToLabel(file=file, scan=labeller.prepare(scan, origin, file.path))


def read_prepared(file: ScanFile, network: Network, origin: Origin | None = None) -> PreparedFile:
    """Read a scan and prepare it for a network.

    Parameters
    ----------
    file : ScanFile
        File of the scan.
    network : Network
        Network for the sensors of such scans.
    origin : tuple of float, optional
        Position of the sensor of a registered scan, in metres; by default found from its points.

    Returns
    -------
    PreparedFile

    Raises
    ------
    FormatError
        If the file cannot be read, or its points are not those of a scan in metres.
    """
    scan = read_measured(file.path, network.sensor)
    projected = project_scan(scan, network.sensor, network.card.sensor, origin, file.path)
    return PreparedFile(file=file, scan=prepare_for(network, projected))


def read_measured(path: Path, sensor: Sensor) -> Scan:
    """Read a scan; refuse one of a few points of which none can be labelled.

    `project_scan` refuses those of more points.
    """
    scan = read_scan(path, sensor)
    if len(scan) < MIN_TRAIT_POINTS and not measured_ranges(scan.points)[1].any():
        count = len(scan)
        problem = f"none of its {count} points is a measurement" if count else "has no points"
        raise FormatError(path, problem, "finite coordinates around the sensor")
    return scan
