# SPDX-License-Identifier: MIT
"""Checks of a scan before the network sees it: units, mounting, view, intensity.

A check that fails for certain is an error of the scan; one that only makes its labels doubtful is a
finding, which becomes a warning of the run. docs/checks.md says where the thresholds come from.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, counted
from salsanext_cli.geometry.coverage import LARGEST_SHARE_OUTSIDE, FieldOfViewCoverage
from salsanext_cli.geometry.ground import TOLERANCE_M
from salsanext_cli.geometry.mounting import in_sensor_frame
from salsanext_cli.geometry.mounting_fit import HEIGHTS_M, MAX_POINTS, MAX_TILT_DEG, ground_of
from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.records import RangeImage, Scan
from salsanext_cli.sensors import FITTED_NAME, Sensor

MEDIAN_RANGES_M = (0.3, 250.0)
"""Least and largest median range of a scan in metres; real scans had 4 to 32."""
MIN_POINTS = 100
"""Fewest points of which a check says something."""
USUAL_RANGES_M = (60.0, 300.0)
"""Largest usual median range and 99 % quantile of ranges; real scans had up to 32 and 104."""
MAX_VIEW_DEG = 120.0
"""Largest usual field of view; that of sensors was 90° or less."""
MAX_WITHOUT_PIXEL = 0.6
"""Largest usual share of the points without a pixel; organised clouds had up to 0.45."""
MIN_ROWS, MIN_COLUMNS_OF_ROW = 0.35, 0.02
"""Least usual share of the rows with points in some of their columns; real scans had 0.47."""
UPSIDE_DOWN_DEG = 155.0
MIN_SHARE_OF_GROUND = 0.15
"""Least share of the near points on a ground that gives reason to doubt."""
SECTORS = 64
MIN_SECTORS = 0.6
"""Least share of the directions around with a point; revolutions had 0.89 or more."""
INTENSITY_FACTOR = 4.0
"""Largest factor between the upper intensities of the scan and of training."""
BRIGHT = 0.95
"""Quantile of the upper intensities."""
MAX_USUAL_INTENSITY = 2.0
"""Largest upper intensity of the scale 0…1, where that of training is not known."""
FIT = "`salsanext inspect SCANS --fit sensor.toml`, then --sensor sensor.toml"
AUTO = f"--sensor auto, or {FIT}"
UNITS = "convert them to metres, or name the columns: --columns x,y,z,intensity"
TRAIN = "expect worse labels, or `salsanext train` weights on scans of this sensor"
ORIGIN = "say where the sensor is, by `origin` in a sensor file, or train weights for that height"


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
    ranges = _require_metres(path, scan, image)
    if coverage.points < MIN_POINTS:
        few = f"{counted(coverage.points, 'point')} with a measurement, too few to check"
        return (Finding("few-points", few, "give whole scans"),)
    named = trained is not None and sensor.name not in (FITTED_NAME, trained.name)
    return (
        *_of_units(ranges, sensor),
        *_of_image(image, sensor, coverage, AUTO if named else FIT),
        *_of_mounting(scan, sensor, AUTO if named else FIT),
        *(() if trained is None else _of_intensity(scan, sensor, trained)),
    )


def _require_metres(path: Path, scan: Scan, image: RangeImage) -> npt.NDArray[np.float64]:
    """Return the ranges of some of the points, if they can be metres."""
    ranges, _ = measured_ranges(scan.points[:: max(1, len(scan) // MAX_POINTS)])
    measured = ranges[np.isfinite(ranges) & (ranges > 0)]
    if len(scan) >= MIN_POINTS and not len(measured) and not image.point_range.any():
        found = f"none of its {len(scan)} points is a measurement"
        raise FormatError(path, found, "finite coordinates around the sensor")
    if len(measured) < MIN_POINTS:
        return measured
    median, (least, most) = float(np.median(measured)), MEDIAN_RANGES_M
    if not least <= median <= most:
        raise FormatError(
            path,
            f"a median range of {median:.3g} m",
            "coordinates in metres, with the sensor at the origin",
            "convert millimetres or centimetres; take the sensor's place off map coordinates",
        )
    return measured


def _of_units(ranges: npt.NDArray[np.float64], sensor: Sensor) -> Iterator[Finding]:
    median, far = np.quantile(ranges, (0.5, 0.99)) if len(ranges) else (0, 0)
    if median > USUAL_RANGES_M[0] or far > USUAL_RANGES_M[1]:
        found = f"a median range of {median:.0f} m, and 1% of the points beyond {far:.0f} m"
        yield Finding("units", found, UNITS)
    if (view := sensor.fov_up - sensor.fov_down) > MAX_VIEW_DEG:
        yield Finding("wide-view", f"a field of view of {view:.0f}°", UNITS)


def _of_image(
    image: RangeImage, sensor: Sensor, coverage: FieldOfViewCoverage, fit: str
) -> Iterator[Finding]:
    if coverage.share > LARGEST_SHARE_OUTSIDE:
        view = f"{sensor.name}, {sensor.fov_up:+g}° to {sensor.fov_down:+g}°"
        found = f"{coverage.share:.0%} of the points lie outside the view of {view}"
        yield Finding("out-of-view", found, fit)
    elif (share := float(np.mean(image.pixel_of_point < 0))) > MAX_WITHOUT_PIXEL:
        found = f"{share:.0%} of the points have no pixel: most are no measurements"
        yield Finding("no-pixel", found, "leave out points without a measurement")
    if (share := _share_of_sectors(image)) < MIN_SECTORS:
        found = f"points in {share:.0%} of the directions around"
        yield Finding("part-of-circle", found, TRAIN)
    occupied = (image.channels[0] > 0).mean(axis=1) > MIN_COLUMNS_OF_ROW * min(share, 1)
    if (share := float(occupied.mean())) < MIN_ROWS:
        found = f"points in {share:.0%} of the {image.height} rows of the image"
        yield Finding("sparse", found, TRAIN)


def _of_mounting(scan: Scan, sensor: Sensor, fit: str) -> Iterator[Finding]:
    ground = ground_of(in_sensor_frame(scan, sensor))
    if ground is None or ground.share < MIN_SHARE_OF_GROUND:
        return
    if ground.tilt_deg > UPSIDE_DOWN_DEG:
        yield Finding("upside-down", "the ground lies above the sensor", fit)
    elif ground.tilt_deg > MAX_TILT_DEG:
        yield Finding("tilted", f"the ground is tilted by {ground.tilt_deg:.0f}°", fit)
    elif not HEIGHTS_M[0] <= ground.height <= HEIGHTS_M[1]:
        height = f"{ground.height:.1f} m above" if abs(ground.height) > TOLERANCE_M else "on"
        yield Finding("height", f"the origin of the points is {height} the ground", ORIGIN)


def _share_of_sectors(image: RangeImage) -> float:
    """Return the share of `SECTORS` equal sectors of the range image with a point."""
    columns = np.flatnonzero((image.channels[0] > 0).any(axis=0))
    return len(np.unique(columns * SECTORS // image.width)) / min(SECTORS, image.width)


def _of_intensity(scan: Scan, sensor: Sensor, trained: Sensor) -> Iterator[Finding]:
    values, quantiles = scan.intensity, trained.intensity_quantiles
    matched = sensor.intensity_quantiles
    if values.min() == values.max():
        given = "the mean of training stands for it" if matched else "the network expects one"
        yield Finding("no-intensity", f"no intensity: {given}", "labels are worse without one")
        return
    if matched:
        return
    bright = float(np.nanquantile(values[:: max(1, len(values) // MAX_POINTS)], BRIGHT))
    usual = quantiles[round(BRIGHT * (len(quantiles) - 1))] if quantiles else None
    if usual is None:
        doubtful, of = bright > MAX_USUAL_INTENSITY, "where 0 to 1 is usual"
    else:
        doubtful = not usual / INTENSITY_FACTOR <= bright <= usual * INTENSITY_FACTOR
        of = f"and {usual:.2g} in training"
    if doubtful:
        found = f"{BRIGHT:.0%} of the intensities are below {bright:.3g}, {of}"
        yield Finding("intensity-scale", found, "--intensity auto, or the sensor's intensity_scale")
