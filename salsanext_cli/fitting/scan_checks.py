# SPDX-License-Identifier: MIT
"""Checks of a scan: units, mounting, view, intensity, from some of its points.

A check that fails for certain is an error of the scan; one that only makes its labels doubtful is a
finding, which becomes a warning of the run. docs/checks.md says where the thresholds come from.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, counted
from salsanext_cli.fitting.coverage import LARGEST_SHARE_OUTSIDE
from salsanext_cli.fitting.findings import MIN_POINTS, Finding, ScanCheck
from salsanext_cli.fitting.ground import TOLERANCE_M
from salsanext_cli.fitting.intensity_checks import intensity_findings, upper_intensity
from salsanext_cli.fitting.mounting_fit import (
    HEIGHTS_M,
    MAX_TILT_DEG,
    UPSIDE_DOWN_DEG,
    ground_of,
)
from salsanext_cli.fitting.scan_traits import traits_of
from salsanext_cli.geometry.few_points import few_points
from salsanext_cli.geometry.intensity import without_intensity
from salsanext_cli.geometry.mounting import ego_points, in_sensor_frame
from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.records import Float, Scan
from salsanext_cli.sensors.sensor import FITTED_NAME, Sensor

MEDIAN_RANGES_M = (0.3, 250.0)
"""Least and largest median range of a scan in metres; real scans had 4 to 32."""
USUAL_RANGES_M = (60.0, 300.0)
"""Largest usual median range and 99 % quantile of ranges; real scans had up to 32 and 104."""
MAX_VIEW_DEG = 120.0
"""Largest usual field of view; that of sensors was 90° or less."""
MIN_MEASURED = 0.4
"""Least usual share of the points with a measurement; organised clouds had 0.55 or more."""
MIN_ROWS, FEW_OF_ROW = 0.35, 0.1
"""Least usual share of the rows with points, more than a tenth of the average; those had 0.47."""
MIN_SHARE_OF_GROUND = 0.15
"""Least share of the near points on a ground that gives reason to doubt."""
SECTORS = 64
MIN_SECTORS = 0.6
"""Least share of the directions around with a point; revolutions had 0.89 or more."""
FIT = "`salsanext inspect SCANS --fit sensor.toml`, then --sensor sensor.toml"
AUTO = "--sensor auto, or "
UNITS = "convert them to metres, or name the columns: --columns x,y,z,intensity"
TRAIN = "expect worse labels, or `salsanext train` weights on scans of this sensor"
ORIGIN = "say by `origin` in a sensor file where the sensor is, or train weights for that height"


def check_scan(
    path: Path, scan: Scan, sensor: Sensor, trained: Sensor | None = None, *, fitting: bool = True
) -> ScanCheck:
    """Check a scan, from some of its points.

    `path`: its file, for errors; `scan`: n points; `sensor`: sensor that it is projected for;
    `trained`: that of the weights, if the intensity matters: if a network is to label the scan or
    to learn from it. One without quantiles stands for intensities from 0 to 1; `fitting`: whether
    the command can fit view and intensity to the scans by itself.
    """
    some = in_sensor_frame(few_points(scan), sensor)
    ranges, measured = measured_ranges(some.points)
    if len(some) < len(scan) and measured.sum() < MIN_POINTS:
        some = in_sensor_frame(scan, sensor)
        ranges, measured = measured_ranges(some.points)
    _require_metres(path, len(scan), ranges[measured])
    own = ego_points(some.points, sensor)
    ego_share = len(own) / max(len(some), 1)
    if len(own):
        some = some.take(np.delete(np.arange(len(some)), own))
        ranges, measured = measured_ranges(some.points)
    if (count := int(measured.sum())) < MIN_POINTS:
        few = f"{counted(count, 'point')} with a measurement, too few to check"
        return ScanCheck((Finding("few-points", few, "give whole scans"),), None, ego_share)
    share, ranges = count / len(some), ranges[measured]
    some = Scan(some.points[measured], some.intensity[measured])
    sines = _sines(some.points)
    reason = without_intensity(some.points, some.intensity)
    named = trained is None or sensor.name not in (FITTED_NAME, trained.name)
    fit = AUTO + FIT if fitting and named else FIT
    findings = [
        *_of_units(ranges, share, sensor),
        *_of_view(some, sines, sensor, fit),
        *_of_ground(some, fit),
    ]
    bright = 0.0 if reason else upper_intensity(some.intensity)
    if trained is not None:
        findings += intensity_findings(bright, reason, sensor, trained, fitting)
    traits = traits_of(sines, bright, len(scan) * (1 - ego_share) * share / count)
    return ScanCheck(tuple(findings), traits, ego_share)


def _require_metres(path: Path, count: int, ranges: npt.NDArray[np.float64]) -> None:
    if count >= MIN_POINTS and not len(ranges):
        found = f"none of its {count} points is a measurement"
        raise FormatError(path, found, "finite coordinates around the sensor")
    if len(ranges) < MIN_POINTS:
        return
    median, (least, most) = float(np.median(ranges)), MEDIAN_RANGES_M
    if not least <= median <= most:
        raise FormatError(
            path,
            f"a median range of {median:.3g} m",
            "coordinates in metres, with the sensor at the origin",
            "convert millimetres or centimetres; take the sensor's place off map coordinates",
        )


def _sines(points: Float) -> Float:
    """Return the sines of elevation of points (N, 3), (N,)."""
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    sines: Float = (points[:, 2] / np.maximum(ranges, np.finfo(np.float32).tiny)).clip(-1, 1)
    return sines


def _of_units(
    ranges: npt.NDArray[np.float64], measured: float, sensor: Sensor
) -> Iterator[Finding]:
    median, far = np.quantile(ranges, (0.5, 0.99))
    if median > USUAL_RANGES_M[0] or far > USUAL_RANGES_M[1]:
        found = f"a median range of {median:.0f} m, and 1% of the points beyond {far:.0f} m"
        yield Finding("units", found, UNITS)
    if (view := sensor.fov_up - sensor.fov_down) > MAX_VIEW_DEG:
        yield Finding("wide-view", f"a field of view of {view:.0f}°", UNITS)
    if measured < MIN_MEASURED:
        found = f"{1 - measured:.0%} of the points are no measurements"
        yield Finding("not-measured", found, "leave them out, or name the columns: --columns")


def _of_view(scan: Scan, sines: Float, sensor: Sensor, fit: str) -> Iterator[Finding]:
    lowest, highest = np.sin(np.radians((sensor.fov_down, sensor.fov_up)))
    outside = float(((sines < lowest) | (sines > highest)).mean())
    if outside > LARGEST_SHARE_OUTSIDE:
        view = f"{sensor.name}, {sensor.fov_up:+g}° to {sensor.fov_down:+g}°"
        found = f"{outside:.0%} of the points lie outside the view of {view}"
        yield Finding("out-of-view", found, fit)
    turns = np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2 * np.pi) + 0.5
    around = float((np.bincount((turns * SECTORS).astype(int) % SECTORS) > 0).sum()) / SECTORS
    if around < MIN_SECTORS:
        yield Finding("part-of-circle", f"points in {around:.0%} of the directions around", TRAIN)
    downwards = sensor.fov_up - np.degrees(np.arcsin(sines))
    rows = (downwards * (sensor.height / (sensor.fov_up - sensor.fov_down))).astype(int)
    per_row = np.bincount(rows.clip(0, sensor.height - 1), minlength=sensor.height)
    occupied = float((per_row > FEW_OF_ROW * per_row.mean()).mean())
    if occupied < MIN_ROWS and outside <= LARGEST_SHARE_OUTSIDE:
        found = f"points in {occupied:.0%} of the {sensor.height} rows of the image"
        yield Finding("sparse", found, TRAIN)


def _of_ground(scan: Scan, fit: str) -> Iterator[Finding]:
    ground = ground_of(scan)
    if ground is None or ground.share < MIN_SHARE_OF_GROUND:
        return
    if ground.tilt_deg > UPSIDE_DOWN_DEG:
        yield Finding("upside-down", "the ground lies above the sensor", fit)
    elif ground.tilt_deg > MAX_TILT_DEG:
        yield Finding("tilted", f"the ground is tilted by {ground.tilt_deg:.0f}°", fit)
    elif not HEIGHTS_M[0] <= ground.height <= HEIGHTS_M[1]:
        where = "above" if ground.height > 0 else "below"
        on_it = abs(ground.height) < TOLERANCE_M
        height = "on" if on_it else f"{abs(ground.height):.1f} m {where}"
        found = f"the origin of the points is {height} the ground"
        yield Finding("height", found, f"{fit}; or {ORIGIN}")
