# SPDX-License-Identifier: MIT
"""Scans to range images on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.formats import read_scan
from salsanext_cli.formats.npy import read_array
from salsanext_cli.formats.reading import filled
from salsanext_cli.geometry.coverage import FieldOfViewCoverage, field_of_view_coverage
from salsanext_cli.geometry.coverage_check import CoverageCheck
from salsanext_cli.geometry.projection import project
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import CHANNELS, Float, RangeImage
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile, output_path
from salsanext_cli.storage.output_run import claimed
from salsanext_cli.storage.point_files import write_array
from salsanext_cli.storage.selection import ScanSelection, select_scans
from salsanext_cli.storage.stage_records import stage_settings

WRITES = ("range", "pixels")


@dataclass(frozen=True, slots=True)
class ProjectScan:
    """Project one scan and write its range image and the pixels of its points."""

    out: Path
    sensor: Sensor

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the files that are written for a scan."""
        return [output_path(self.out, file.sequence, folder, file.stem) for folder in WRITES]

    def is_done(self, file: ScanFile) -> bool:
        """Whether a scan has all its results."""
        return all(filled(path) for path in self.results_of(file))

    def __call__(self, file: ScanFile) -> FieldOfViewCoverage:
        """Read, project, write; return how much of the scan is in view."""
        image, seen = read_and_project(file, self.sensor)
        range_path, pixels_path = self.results_of(file)
        write_array(range_path, image.channels)
        write_array(pixels_path, image.pixel_of_point)
        return seen


def read_image(file: ScanFile, sensor: Sensor, device: str = "cpu") -> RangeImage:
    """Read a scan and project it."""
    return read_and_project(file, sensor, device)[0]


def read_and_project(
    file: ScanFile, sensor: Sensor, device: str = "cpu"
) -> tuple[RangeImage, FieldOfViewCoverage]:
    """Read a scan and project it; return how much of it is in view, too."""
    scan = read_scan(file.path, intensity_scale=sensor.intensity_scale)
    return project(scan, sensor, device), field_of_view_coverage(scan, sensor)


def read_channels(path: Path, sensor: Sensor) -> Float:
    """Read the (5, H, W) channels of a range image that `project_scans` wrote."""
    shape = (len(CHANNELS), sensor.height, sensor.width)
    channels: Float = read_array(path, "float32", shape)
    return channels


def projected_sensor(folder: Path) -> Sensor | None:
    """Return the sensor of the range images in an output folder, None if it holds none."""
    settings = stage_settings(folder, "project")
    if settings is None:
        return None
    return Sensor.from_dict(settings.table("sensor"), settings.path)


def project_scans(
    source: Path,
    out: Path,
    *,
    sensor: Sensor,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Outcome[FieldOfViewCoverage]:
    """Project scans to `OUT/sequences/<seq>/range` and `pixels`.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence or a data set.
    out : Path
        The output folder.
    sensor : Sensor
        Field of view and size of the range images.
    selection, options
        Which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    scans = select_scans(source, selection)
    settings = {"sensor": sensor.to_dict()}
    work, check = ProjectScan(out, sensor), CoverageCheck(sensor)
    with claimed(out, "project", settings, WRITES, scans, overwrite=options.overwrite):
        outcome = run_over_scans(work, scans, options, is_done=work.is_done, on_result=check.add)
    check.finish()
    return outcome
