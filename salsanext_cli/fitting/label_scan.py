# SPDX-License-Identifier: MIT
"""The way of a scan: read, checked, projected, through the network, refined on the points."""

from collections.abc import Generator
from dataclasses import dataclass

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.engines.network import Network
from salsanext_cli.fitting.findings import ScanCheck
from salsanext_cli.fitting.scan_checks import check_scan
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.geometry.projection import project
from salsanext_cli.records import Float, RangeImage, Scan
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedScan:
    """Scan that was read, checked and projected."""

    file: ScanFile
    scan: Scan  # N points
    image: RangeImage  # H × W pixels
    check: ScanCheck  # Reasons to doubt the scan


@dataclass(frozen=True, slots=True, eq=False)
class LabelledScan(ProjectedScan):
    """Scan with the labels that a network gives it."""

    softmax: Float  # (C, H, W) float32: of the pixels
    labels: TrainIds  # (N,) uint8: of the points, refined by kNN


def project_scan(
    file: ScanFile, sensor: Sensor, device: str = "cpu", trained: Sensor | None = None
) -> ProjectedScan:
    """Read, check and project a scan.

    `sensor`: what the scan is projected for; `device`: as `project` takes it; `trained`: that of
    the weights, if a network is to label the scan.
    """
    scan = read_scan(file.path, sensor)
    check = check_scan(file.path, scan, sensor, trained)
    return ProjectedScan(file, scan, project(scan, sensor, device), check)


def project_for(network: Network, file: ScanFile) -> ProjectedScan:
    """Read, check and project a scan that a network is to label."""
    return project_scan(file, network.sensor, network.device, network.card.sensor)


def labelled(
    projected: ProjectedScan, softmax: Float, network: Network, knn: KnnParameters
) -> LabelledScan:
    """Return a projected scan with the labels that follow from its pixels' softmax (C, H, W)."""
    network.engine.require_finite(softmax, projected.file.path)
    labels = network.labels(projected.image, softmax, knn)
    parts = (projected.file, projected.scan, projected.image, projected.check)
    return LabelledScan(*parts, softmax, labels)


def label_scan(
    file: ScanFile, network: Network, knn: KnnParameters = KnnParameters()
) -> Generator[None, None, LabelledScan]:
    """Label a scan in steps: yields when it is projected, and when its softmax is computed."""
    projected = project_for(network, file)
    yield
    softmax = network.probabilities(projected.image, file.path)
    yield
    return labelled(projected, softmax, network, knn)
