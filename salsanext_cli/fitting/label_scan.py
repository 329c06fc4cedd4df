# SPDX-License-Identifier: MIT
"""The way of a scan: read, checked, projected, through the network, refined on the points."""

from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import UsageError
from salsanext_cli.fitting.scan_checks import ScanCheck, check_scan
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.npy import read_array
from salsanext_cli.geometry.projection import project
from salsanext_cli.options import KnnParameters
from salsanext_cli.records import CHANNELS, Float, RangeImage, Scan
from salsanext_cli.results.layout import ScanFile, output_path
from salsanext_cli.results.stage_records import StageRecords, differences, recorded_sensor
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


def label_scan(
    file: ScanFile, network: Network, knn: KnnParameters = KnnParameters()
) -> Generator[RangeImage | None, Float | None, LabelledScan]:
    """Label a scan: yields its range image, for which a softmax may be sent, and None after it."""
    projected = project_for(network, file)
    softmax = yield projected.image
    if softmax is None:
        softmax = network.probabilities(projected.image, file.path)
    yield None
    return labelled(projected, softmax, network, knn)


def project_for(network: Network, file: ScanFile, scan: Scan | None = None) -> ProjectedScan:
    """Read, check and project a scan that a network is to label; `scan`: if it was read."""
    return project_scan(file, network.sensor, network.card.sensor, scan)


def project_scan(
    file: ScanFile, sensor: Sensor, trained: Sensor | None = None, scan: Scan | None = None
) -> ProjectedScan:
    """Read, check and project a scan; `trained` is the sensor of weights that are to label it."""
    scan = read_scan(file.path, sensor) if scan is None else scan
    check = check_scan(file.path, scan, sensor, trained)
    return ProjectedScan(file, scan, project(scan, sensor), check)


def labelled(
    projected: ProjectedScan, softmax: Float, network: Network, knn: KnnParameters
) -> LabelledScan:
    """Return a projected scan with the labels that follow from its pixels' softmax (C, H, W)."""
    network.engine.require_finite(softmax, projected.file.path)
    labels = network.labels(projected.image, softmax, knn)
    scan = projected.scan
    return LabelledScan(projected.file, scan, projected.image, projected.check, softmax, labels)


def range_image(file: ScanFile, folder: Path, sensor: Sensor) -> tuple[Path, Float]:
    """Read what `project` wrote of a scan; return the file and its content, (5, H, W) float32."""
    path = output_path(folder, file.sequence, "range", file.stem)
    return path, read_array(path, "float32", (len(CHANNELS), sensor.height, sensor.width))


def projected_sensor(folder: Path) -> Sensor | None:
    """Return the sensor of the range images in an output folder, None if it holds none."""
    return recorded_sensor(StageRecords(folder).settings("project"))


def sensor_of_images(folder: Path, projected: Sensor | None, wanted: Sensor) -> Sensor:
    """Return the network's sensor with the columns of the scans; refuse another geometry."""
    if projected is None:
        raise UsageError(folder, "holds no range images", "the output folder of `project`")
    wanted = replace(wanted, columns=projected.columns)
    normalised = replace(projected, means=wanted.means, stds=wanted.stds)
    if changed := differences(normalised.view(), wanted.view()):
        raise UsageError(
            folder,
            f"range images of {projected.name}, {projected.height}×{projected.width}: {changed}",
            "those that the weights or --sensor say",
            "project again, or give the sensor that was projected with",
        )
    return wanted
