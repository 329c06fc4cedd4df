# SPDX-License-Identifier: MIT
"""Checks of a scan before the network sees it: units, mounting, view, intensity.

A check that fails for certain is an error of the scan; one that only makes its labels doubtful is a
finding, which becomes a warning of the run. docs/checks.md says where the thresholds come from.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.errors import FormatError
from salsanext_cli.geometry.coverage import LARGEST_SHARE_OUTSIDE, FieldOfViewCoverage
from salsanext_cli.geometry.intensity import (
    BRIGHT,
    INTENSITY_FACTOR,
    NO_INTENSITY,
    without_intensity,
)
from salsanext_cli.geometry.mounting import in_sensor_frame
from salsanext_cli.geometry.mounting_fit import HEIGHTS_M, MAX_POINTS, MAX_TILT_DEG, ground_of
from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.records import RangeImage, Scan
from salsanext_cli.sensors import Sensor

MEDIAN_RANGES_M = (0.3, 250.0)
"""Least and largest median range of a scan in metres; real scans had 4 to 32."""
MIN_POINTS = 100
"""Fewest points of which a check says something."""
UPSIDE_DOWN_DEG = 155.0
SECTORS = 64
MIN_SECTORS = 0.6
"""Least share of the directions around with a point; revolutions had 0.89 or more."""
MAX_USUAL_INTENSITY = 2.0
"""Largest upper intensity of the scale 0…1, where that of training is not known."""
FIT = "--sensor auto, or `salsanext inspect SCANS --fit sensor.toml` and --sensor sensor.toml"
NAME_IT = (
    "if the files hold one, name its column, --columns x,y,z,_,intensity for example, or its "
    "scale, intensity_scale in a file for --sensor"
)
ORIGIN = (
    "if it is not the sensor's, --sensor auto, or `origin` in a sensor file; else train weights"
)


@dataclass(frozen=True, slots=True)
class Finding:
    """Reason to doubt the labels of a scan.

    Attributes
    ----------
    code : str
        Name of the check, which stays; see docs/checks.md.
    found, remedy : str
        What is doubtful about this scan, and what to do.
    """

    code: str
    found: str
    remedy: str


def check_scan(
    path: Path,
    scan: Scan,
    image: RangeImage,
    sensor: Sensor,
    coverage: FieldOfViewCoverage,
    trained: Sensor | None = None,
) -> tuple[Finding, ...]:
    """Check a scan.

    Parameters
    ----------
    path : Path
        Its file, for errors.
    scan, image : Scan, RangeImage
        The scan, and what the sensor sees of it.
    sensor : Sensor
        Sensor that it was projected for.
    coverage : FieldOfViewCoverage
        Numbers of its points in and out of that sensor's view.
    trained : Sensor, optional
        That of the weights, if a network is to label the scan.

    Raises
    ------
    FormatError
        If the scan cannot be right: no point with a measurement, or not in metres around the
        sensor.
    """
    _require_metres(path, scan, image)
    if coverage.points < MIN_POINTS:
        return ()
    return (
        *_of_geometry(scan, image, sensor, coverage),
        *(() if trained is None else _of_intensity(scan, sensor, trained)),
    )


def _require_metres(path: Path, scan: Scan, image: RangeImage) -> None:
    ranges, _ = measured_ranges(scan.points[:: max(1, len(scan) // MAX_POINTS)])
    measured = ranges[np.isfinite(ranges) & (ranges > 0)]
    if len(scan) >= MIN_POINTS and not len(measured) and not image.point_range.any():
        found = f"none of its {len(scan)} points is a measurement"
        raise FormatError(path, found, "finite coordinates around the sensor")
    if len(measured) < MIN_POINTS:
        return
    median, (least, most) = float(np.median(measured)), MEDIAN_RANGES_M
    if not least <= median <= most:
        raise FormatError(
            path,
            f"a median range of {median:.3g} m",
            "coordinates in metres, with the sensor at the origin",
            "convert millimetres or centimetres; take the sensor's place off map coordinates",
        )


def _of_geometry(
    scan: Scan, image: RangeImage, sensor: Sensor, coverage: FieldOfViewCoverage
) -> Iterator[Finding]:
    if coverage.share > LARGEST_SHARE_OUTSIDE:
        view = f"{sensor.name}, {sensor.fov_up:+g}° to {sensor.fov_down:+g}°"
        found = f"{coverage.share:.0%} of the points lie outside the view of {view}"
        yield Finding("out-of-view", found, FIT)
    if (share := _share_of_sectors(image)) < MIN_SECTORS:
        found = f"points in {share:.0%} of the directions around"
        yield Finding("part-of-circle", found, "the network knows whole revolutions")
    if (ground := ground_of(in_sensor_frame(scan, sensor))) is None:
        return
    if ground.tilt_deg > UPSIDE_DOWN_DEG:
        yield Finding("upside-down", "the ground lies above the sensor", FIT)
    elif ground.tilt_deg > MAX_TILT_DEG:
        found = f"the ground is tilted by {ground.tilt_deg:.0f}°: is z up?"
        yield Finding("tilted", found, FIT)
    elif not HEIGHTS_M[0] <= ground.height <= HEIGHTS_M[1]:
        found = f"the origin of the points is {ground.height:.1f} m above the ground"
        yield Finding("height", found, ORIGIN)


def _share_of_sectors(image: RangeImage) -> float:
    """Return the share of `SECTORS` equal sectors of the range image with a point."""
    columns = np.flatnonzero((image.channels[0] > 0).any(axis=0))
    return len(np.unique(columns * SECTORS // image.width)) / min(SECTORS, image.width)


def _of_intensity(scan: Scan, sensor: Sensor, trained: Sensor) -> Iterator[Finding]:
    """Compare with the scans that it is matched with, else with training, else with 0 to 1."""
    matched = sensor.intensity_quantiles
    if reason := without_intensity(in_sensor_frame(scan, sensor).points, scan.intensity):
        found = reason if matched else f"{reason}; the network takes it as it is"
        remedy = "--intensity none" if trained.intensity_quantiles and not matched else NAME_IT
        yield Finding("no-intensity", found, remedy)
        return
    quantiles = matched or trained.intensity_quantiles
    if matched == NO_INTENSITY:
        return
    bright = float(np.nanquantile(scan.intensity[:: max(1, len(scan) // MAX_POINTS)], BRIGHT))
    if quantiles:
        usual = quantiles[round(BRIGHT * (len(quantiles) - 1))]
        near = usual / INTENSITY_FACTOR <= bright <= usual * INTENSITY_FACTOR
        doubtful = usual > 0 and not near  # Decibels have no factors.
        of = f"and {usual:.2g} in {'the scans fitted to' if matched else 'training'}"
    else:
        doubtful, of = bright > MAX_USUAL_INTENSITY, "where 0 to 1 is usual"
    if doubtful:
        found = f"{BRIGHT:.0%} of the intensities are below {bright:.3g}, {of}"
        scale = "set intensity_scale in a file for --sensor"
        remedy = f"run it apart, or {scale}" if matched else f"--intensity auto, or {scale}"
        yield Finding("intensity-scale", found, remedy)
