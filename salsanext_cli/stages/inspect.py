# SPDX-License-Identifier: MIT
"""Look at a set of scans: how many, how large, what they see, which classes they hold."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import NoInputError, OutputError
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.reading import present
from salsanext_cli.geometry.coverage import (
    CoverageCheck,
    FieldOfViewCoverage,
    field_of_view_coverage,
)
from salsanext_cli.geometry.projection import project
from salsanext_cli.measures.survey import Survey, survey
from salsanext_cli.parallel.run import Failure, RunOptions, run_over_scans
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.atomic import write_text
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import ScanSelection, select_scans, space_of

BRIGHT = 1.5
"""Intensities above this have another scale than 0…1."""

FEWEST_POINTS = 1000
"""A fit leaves out one point in a thousand at either edge."""
SMALLEST_VIEW = 1.0
"""Degrees; a scanner of one plane sees less, a LiDAR for range images at least some."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Inspection:
    """What was found.

    Attributes
    ----------
    sequences : dict of str to Survey
        By sequence.
    total : Survey
        Of all.
    sensor : Sensor
        The sensor that the range images were counted with.
    space : LabelSpace
        What the classes are called.
    failures : tuple of Failure
        Scans that could not be read.
    """

    sequences: dict[str, Survey]
    total: Survey
    sensor: Sensor
    space: LabelSpace
    failures: tuple[Failure, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "stage": "inspect",
            "sensor": self.sensor.to_dict(),
            "total": self.total.to_dict(),
            "sequences": {name: found.to_dict() for name, found in self.sequences.items()},
            "failures": [{"scan": str(f.scan.path), "reason": f.reason} for f in self.failures],
        }

    def fitted_sensor(self, name: str) -> Sensor:
        """Return the sensor with the field of view and normalisation of these scans.

        Raises
        ------
        NoInputError
            If their points are too few, or do not span what a LiDAR sees.
        """
        _require_believable(name, self.total)
        return replace(
            _seen_whole(self.sensor, self.total),
            name=name,
            means=tuple(round(mean, 4) for mean in self.total.means),
            stds=tuple(round(std, 4) for std in self.total.stds),
        )


def _require_believable(name: str, found: Survey) -> None:
    """Refuse to fit a sensor to what is no picture of its field of view."""
    measured = found.points - found.invalid
    up, down = found.field_of_view()
    if measured < FEWEST_POINTS:
        raise NoInputError(
            name,
            f"{measured} points with a measurement",
            f"{FEWEST_POINTS} or more",
            "fit a sensor to whole scans",
        )
    if up - down < SMALLEST_VIEW:
        raise NoInputError(
            name,
            f"a field of view of {up - down:.2f}°, from {up:+.2f}° to {down:+.2f}°",
            f"{SMALLEST_VIEW:g}° or more",
            "fit a sensor to whole scans of a 3D LiDAR, with z up and its origin at the sensor",
        )


def _seen_whole(sensor: Sensor, found: Survey) -> Sensor:
    """Return the sensor with the field of view that was found."""
    up, down = found.field_of_view()
    return replace(sensor, fov_up=round(up, 2), fov_down=round(down, 2))


@dataclass(frozen=True, slots=True)
class InspectScan:
    """Survey one scan."""

    sensor: Sensor

    def __call__(self, file: ScanFile) -> tuple[str, Survey, FieldOfViewCoverage]:
        """Read, project, count."""
        scan = read_scan(file.path, intensity_scale=self.sensor.intensity_scale)
        labelled = present(file.label_path)
        raw = read_labels(file.label_path, len(scan)) if labelled else None
        found = survey(scan, project(scan, self.sensor), raw)
        return file.sequence, found, field_of_view_coverage(scan, self.sensor)


def inspect(
    source: Path,
    *,
    sensor: Sensor,
    space: LabelSpace | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
    fit: bool = False,
) -> Inspection:
    """Survey scans.

    Parameters
    ----------
    source : Path
        A scan, a folder of scans, a sequence or a data set.
    sensor : Sensor
        Size of the range images, over whose pixels means and deviations are taken.
    space : LabelSpace, optional
        What the classes are called; otherwise the data set's own, else SemanticKITTI's.
    selection, options
        Which scans, and how to go through them.
    fit : bool
        Go through them twice: first for the field of view, then for the range images seen in it.

    Raises
    ------
    SalsanextError
        If nothing can be done at all; failures of single scans are in the result.
    """
    scans = select_scans(source, selection, space)
    sequences, failures = _survey(scans, sensor, options, fit)
    total = sum(sequences.values(), start=Survey())
    if fit and total.pixels:
        sensor = _seen_whole(sensor, total)
        sequences, failures = _survey(scans, sensor, options, fit)
        total = sum(sequences.values(), start=Survey())
    if total.brightest > BRIGHT:
        bright = f"intensities up to {total.brightest:g}, where 0 to 1 is usual"
        log.warning("%s: set intensity_scale in the sensor", bright)
    return Inspection(
        sequences=dict(sorted(sequences.items())),
        total=total,
        sensor=sensor,
        space=space or space_of(scans),
        failures=failures,
    )


def _survey(
    scans: list[ScanFile], sensor: Sensor, options: RunOptions, fit: bool
) -> tuple[dict[str, Survey], tuple[Failure, ...]]:
    sequences: dict[str, Survey] = {}
    check = CoverageCheck(sensor)

    def add(result: tuple[str, Survey, FieldOfViewCoverage]) -> None:
        name, found, seen = result
        sequences[name] = sequences.get(name, Survey()) + found
        if not fit:
            check.add(seen)

    outcome = run_over_scans(InspectScan(sensor), scans, options, on_result=add)
    check.finish()
    return sequences, outcome.failures


def write_sensor(path: Path, sensor: Sensor, *, overwrite: bool = False) -> None:
    """Write a sensor as the TOML file that `--sensor` takes.

    Raises
    ------
    OutputError
        If the file exists and may not be overwritten, or cannot be written.
    """
    if present(path) and not overwrite:
        raise OutputError(path, "exists", remedy="use another name, or --overwrite")
    values = {k: v for k, v in sensor.to_dict().items() if k != "name" and v is not None}
    lines = [f"{key} = {_toml(value)}\n" for key, value in values.items()]
    write_text(path, "".join(lines))


def _toml(value: object) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(_toml(item) for item in value)}]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else str(value)
