# SPDX-License-Identifier: MIT
"""Scans to range images on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.formats import read_scan
from salsanext_cli.formats.arrays import read_array, write_array
from salsanext_cli.formats.layout import ScanFile, output_path
from salsanext_cli.geometry.projection import project
from salsanext_cli.geometry.sight import Sight, sight
from salsanext_cli.records import CHANNELS, Float, RangeImage
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.batch import BatchOptions, Outcome, run_batch
from salsanext_cli.stages.claims import claimed
from salsanext_cli.stages.inputs import Choice, select_scans
from salsanext_cli.stages.outputs import stage_settings
from salsanext_cli.stages.wrong_view import ViewCheck

WRITES = ("range", "pixels")


@dataclass(frozen=True, slots=True)
class ProjectScan:
    """Project one scan and write its range image and the pixels of its points."""

    out: Path
    sensor: Sensor

    def results_of(self, file: ScanFile) -> list[Path]:
        """Return the files that are written for a scan."""
        return [output_path(self.out, file.sequence, folder, file.stem) for folder in WRITES]

    def __call__(self, file: ScanFile) -> Sight:
        """Read, project, write; return how much of the scan is in view."""
        image, seen = read_seen(file, self.sensor)
        range_path, pixels_path = self.results_of(file)
        write_array(range_path, image.channels)
        write_array(pixels_path, image.pixel_of_point)
        return seen


def read_image(file: ScanFile, sensor: Sensor, device: str = "cpu") -> RangeImage:
    """Read a scan and project it."""
    return read_seen(file, sensor, device)[0]


def read_seen(file: ScanFile, sensor: Sensor, device: str = "cpu") -> tuple[RangeImage, Sight]:
    """Read a scan and project it; return how much of it is in view, too."""
    scan = read_scan(file.path, intensity_scale=sensor.intensity_scale)
    return project(scan, sensor, device), sight(scan, sensor)


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
    choice: Choice = Choice(),
    options: BatchOptions = BatchOptions(),
) -> Outcome[Sight]:
    """Project scans to `OUT/sequences/<seq>/range` and `pixels`.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence or a data set.
    out : Path
        The output folder.
    sensor : Sensor
        Field of view and size of the range images.
    choice, options
        Which scans, and how to go through them.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the outcome.
    """
    scans = select_scans(source, choice)
    settings = {"sensor": sensor.to_dict()}
    work, check = ProjectScan(out, sensor), ViewCheck(sensor)
    with claimed(out, "project", settings, WRITES, scans, overwrite=options.overwrite):
        outcome = run_batch(work, scans, options, work.results_of, check.add)
    check.finish()
    return outcome
