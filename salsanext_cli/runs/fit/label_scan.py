# SPDX-License-Identifier: MIT
"""Steps of a scan: read, check, project, predict the pixels, refine the labels of the points."""

from dataclasses import dataclass, replace
from itertools import starmap
from pathlib import Path
from typing import NamedTuple

import numpy as np

from salsanext_cli.core.checks.scan_checks import ScanCheck, check_scan
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import FormatError, UsageError
from salsanext_cli.core.geometry.knn import knn_refine
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.projection import (
    ego_points,
    in_sensor_frame,
    measured_ranges,
    project,
)
from salsanext_cli.core.geometry.scan_traits import MIN_TRAIT_POINTS
from salsanext_cli.core.geometry.sensor_of_scan import origin_of_scan, sensor_of
from salsanext_cli.core.records import CHANNELS, Float, RangeImage, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.npy import read_array
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.paths import ScanFile, output_path
from salsanext_cli.runs.results.setting_differences import differences


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedScan:
    """Scan that was read, checked and projected."""

    file: ScanFile
    scan: Scan  # N points
    image: RangeImage  # H × W pixels
    check: ScanCheck
    sensor: Sensor  # Member of a fitted sensor that the scan belongs to
    origin: tuple[float, ...] | None  # By which the member was found; None if no scan has its own


class PreparedScan(NamedTuple):
    """Scan that is ready for a network."""

    projected: ProjectedScan
    network: Network  # For the sensor of the scan
    input: Float  # (1, 5, H, W) float32, normalised


@dataclass(frozen=True, slots=True, eq=False)
class LabelledScan(ProjectedScan):
    """Scan with the labels of a network."""

    pixels: PixelPrediction
    labels: TrainIds  # (N,) uint8, refined by kNN


def prepared_for(
    network: Network,
    file: ScanFile,
    scan: Scan | None = None,
    origin: tuple[float, ...] | None = None,
) -> PreparedScan:
    """Read, unless it is given, check and project a scan for a network.

    `origin`: that of a registered scan in metres, by default found from its points.
    """
    projected = project_scan(file, network.sensor, network.card.sensor, scan, origin)
    network = network.for_sensor(projected.sensor)
    return PreparedScan(projected, network, network.input(projected.image.channels))


def project_scan(
    file: ScanFile,
    sensor: Sensor,
    trained: Sensor | None = None,
    scan: Scan | None = None,
    origin: tuple[float, ...] | None = None,
) -> ProjectedScan:
    """Read, unless it is given, check and project a scan.

    `trained`: sensor of the weights; `origin`: that of a registered scan in metres, by default
    found from its points.
    """
    if scan is None:
        scan = read_scan(file.path, sensor)
        _require_measurements(file.path, scan)
    origin = origin_of_scan(scan, sensor, origin)
    sensor = sensor_of(scan, sensor, origin)
    check = check_scan(file.path, scan, sensor, trained)
    image = project(scan, sensor)
    check = replace(check, points=len(scan), ego_points=_ego_count(scan, image, sensor))
    return ProjectedScan(file, scan, image, check, sensor, origin)


def _ego_count(scan: Scan, image: RangeImage, sensor: Sensor) -> int:
    """Count the points of a scan on the housing of its sensor or its vehicle."""
    without_pixel = scan.take(np.flatnonzero(image.pixel_of_point < 0))
    return len(ego_points(in_sensor_frame(without_pixel, sensor).points, sensor))


def _require_measurements(path: Path, scan: Scan) -> None:
    """Refuse a scan of a few points of which none can be labelled; `check_scan` refuses others."""
    if len(scan) < MIN_TRAIT_POINTS and not measured_ranges(scan.points)[1].any():
        count = len(scan)
        problem = f"none of its {count} points is a measurement" if count else "has no points"
        raise FormatError(path, problem, "finite coordinates around the sensor")


def labelled(scan: PreparedScan, pixels: PixelPrediction, knn: KnnParameters) -> LabelledScan:
    """Return a scan with the labels of its points, refined from the prediction of its pixels."""
    projected = scan.projected
    network = scan.network
    network.backend.require_finite(pixels.confidence, projected.file.path)
    labels = knn_refine(projected.image, pixels.labels, network.space.class_count, knn)
    return LabelledScan(
        projected.file,
        projected.scan,
        projected.image,
        projected.check,
        projected.sensor,
        projected.origin,
        pixels,
        labels,
    )


def range_image(file: ScanFile, folder: Path, sensor: Sensor) -> Float:
    """Read the range image (5, H, W) float32 that `project` wrote of a scan."""
    path = output_path(folder, file.sequence, "range", file.stem)
    return read_array(path, "float32", (len(CHANNELS), sensor.height, sensor.width))


def projected_sensor(folder: Path) -> Sensor | None:
    """Return the sensor of the range images in an output folder, None without any."""
    projected = Manifest(folder).settings("project")
    return projected.sensor if projected else None


def sensor_of_images(folder: Path, projected: Sensor | None, fitted: Sensor) -> Sensor:
    """Return the sensor of a network for projected scans; refuse another geometry than theirs."""
    if projected is None:
        raise UsageError(folder, "has no range images", "the output folder of `project`")
    fits = [
        replace(member, columns=projected.columns, intensity_field=projected.intensity_field)
        for member in fitted.members
    ]
    images = [replace(other, means=fitted.means, stds=fitted.stds) for other in projected.members]
    pairs = ((a.view(), b.view()) for a, b in zip(images, fits, strict=False))
    counts = ({"sensors": len(images)}, {"sensors": len(fits)})
    if changed := next(filter(None, starmap(differences, (counts, *pairs))), ""):
        size = f"{projected.height}×{projected.width}"
        problem = f"has range images of {projected.name}, {size}: {changed}"
        hint = "project again, or pass --sensor and --width of `project`"
        raise UsageError(folder, problem, "the sensor of the weights or of --sensor", hint)
    return replace(fits[0], others=tuple(fits[1:]))
