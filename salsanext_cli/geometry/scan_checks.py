# SPDX-License-Identifier: MIT
"""Checks of a scan: units, mounting, view, intensity, from some of its points.

A check that fails for certain is an error of the scan; one that only makes its labels doubtful is a
finding, which becomes a warning of the run. docs/checks.md says where the thresholds come from.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError
from salsanext_cli.geometry.coverage import LARGEST_SHARE_OUTSIDE
from salsanext_cli.geometry.ground import find_ground
from salsanext_cli.geometry.intensity import BRIGHT, INTENSITY_FACTOR
from salsanext_cli.geometry.mounting import upright
from salsanext_cli.geometry.ranges import measured_ranges
from salsanext_cli.geometry.scan_traits import ScanTraits, traits_of
from salsanext_cli.geometry.view_fit import MAX_TILT_DEG, few_points
from salsanext_cli.records import Float, Scan
from salsanext_cli.sensors import Sensor

MEDIAN_RANGES_M = (0.3, 250.0)
"""Least and largest median range of a scan in metres; real scans had 4 to 32."""
MIN_POINTS = 100
"""Fewest points of which a check says something."""
UPSIDE_DOWN_DEG = 155.0
HEIGHTS_M = (1.0, 3.2)
"""Least and largest height of a sensor on a vehicle; those of the real scans were 1.4 to 2.1."""
SECTORS = 64
MIN_SECTORS = 0.6
"""Least share of the directions around with a point; revolutions had 0.89 or more."""
MAX_USUAL_INTENSITY = 2.0
"""Largest upper intensity of the scale 0…1, where that of training is not known."""
FIT = "`salsanext inspect SCANS --fit sensor.toml` and --sensor sensor.toml"
AUTO = "--sensor auto, or "


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


@dataclass(frozen=True, slots=True)
class ScanCheck:
    """Result of a check: reasons to doubt the scan, and traits of its sensor.

    Attributes
    ----------
    findings : tuple of Finding
    traits : ScanTraits, optional
        None of a scan of fewer than `MIN_POINTS` points with a measurement.
    """

    findings: tuple[Finding, ...] = ()
    traits: ScanTraits | None = None


UNCHECKED = ScanCheck()


def check_scan(
    path: Path, scan: Scan, sensor: Sensor, trained: Sensor | None = None, *, fitting: bool = True
) -> ScanCheck:
    """Check a scan, from some of its points.

    Parameters
    ----------
    path : Path
        Its file, for errors.
    scan : Scan
        N points.
    sensor : Sensor
        Sensor that it is projected for.
    trained : Sensor, optional
        That of the weights, if the intensity matters: if a network is to label the scan or to
        learn from it. One without quantiles stands for intensities from 0 to 1.
    fitting : bool
        Whether the command can fit view and intensity to the scans by itself.

    Raises
    ------
    FormatError
        If the scan cannot be right: no point with a measurement, or not in metres around the
        sensor.
    """
    some = few_points(scan)
    ranges, measured = measured_ranges(some.points)
    if len(some) < len(scan) and measured.sum() < MIN_POINTS:
        some = scan
        ranges, measured = measured_ranges(some.points)
    _require_metres(path, len(scan), ranges[measured])
    if measured.sum() < MIN_POINTS:
        return ScanCheck()
    some = upright(Scan(some.points[measured], some.intensity[measured]), sensor)
    sines = (some.points[:, 2] / ranges[measured]).clip(-1, 1).astype(np.float32)
    constant = _is_constant(some.intensity) and _is_constant(scan.intensity)
    bright = 0.0 if constant else _bright(some.intensity)
    findings = [*_of_view(some, sines, sensor, fitting), *_of_ground(some, fitting)]
    if trained is not None:
        if constant:
            findings.append(_without_intensity(sensor))
        else:
            findings += _of_intensity(bright, sensor, trained, fitting)
    traits = traits_of(sines, bright, len(scan) / len(measured))
    return ScanCheck(tuple(findings), traits)


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


def _of_view(scan: Scan, sines: Float, sensor: Sensor, fitting: bool) -> Iterator[Finding]:
    lowest, highest = np.sin(np.radians((sensor.fov_down, sensor.fov_up)))
    outside = float(((sines < lowest) | (sines > highest)).mean())
    if outside > LARGEST_SHARE_OUTSIDE:
        view = f"{sensor.name}, {sensor.fov_up:+g}° to {sensor.fov_down:+g}°"
        found = f"{outside:.0%} of the points lie outside the view of {view}"
        yield Finding("out-of-view", found, _fit(fitting))
    turns = np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2 * np.pi) + 0.5
    around = float((np.bincount((turns * SECTORS).astype(int) % SECTORS) > 0).sum()) / SECTORS
    if around < MIN_SECTORS:
        found = f"points in {around:.0%} of the directions around"
        yield Finding("part-of-circle", found, "the networks know whole revolutions")


def _of_ground(scan: Scan, fitting: bool) -> Iterator[Finding]:
    if (ground := find_ground(scan.points)) is None:
        return
    if ground.tilt_deg > UPSIDE_DOWN_DEG:
        yield Finding("upside-down", "the ground lies above the sensor", _fit(fitting))
    elif ground.tilt_deg > MAX_TILT_DEG:
        found = f"the ground is tilted by {ground.tilt_deg:.0f}°: is z up?"
        yield Finding("tilted", found, _fit(fitting))
    elif not HEIGHTS_M[0] <= ground.height <= HEIGHTS_M[1]:
        found = f"the sensor is {ground.height:.1f} m above the ground"
        yield Finding("height", found, "take weights of sensors at that height, or train some")


def _fit(fitting: bool) -> str:
    return AUTO + FIT if fitting else FIT


def _is_constant(intensity: Float) -> bool:
    """Say whether all intensities that are numbers are equal."""
    finite = intensity[np.isfinite(intensity)]
    return not len(finite) or bool(finite.min() == finite.max())


def _bright(intensity: Float) -> float:
    """Return the upper intensity of those that are numbers, 0 without any."""
    finite = intensity[np.isfinite(intensity)]
    return float(np.quantile(finite, BRIGHT)) if len(finite) else 0.0


def _without_intensity(sensor: Sensor) -> Finding:
    matched = sensor.intensity_quantiles
    given = "the mean of training stands for it" if matched else "the network expects one"
    return Finding("no-intensity", f"no intensity: {given}", "labels are worse without one")


def _of_intensity(
    bright: float, sensor: Sensor, trained: Sensor, fitting: bool
) -> Iterator[Finding]:
    """Compare with the scans that it is matched with, else with training, else with 0 to 1."""
    matched = sensor.intensity_quantiles
    quantiles = matched or trained.intensity_quantiles
    if matched and min(matched) == max(matched):
        return
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
        remedy = scale if matched or not fitting else f"--intensity auto, or {scale}"
        yield Finding("intensity-scale", found, remedy)
