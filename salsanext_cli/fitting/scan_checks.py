# SPDX-License-Identifier: MIT
"""Checks of scans: units, mounting, view, intensity, from some of their points, and one sensor.

A check that fails for certain is an error of the scan; one that only makes its labels doubtful is a
finding, which becomes a warning of the run. warnings.md says where the thresholds come from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, counted
from salsanext_cli.fitting.mounting_fit import (
    HEIGHTS_M,
    MAX_TILT_DEG,
    TOLERANCE_M,
    UPSIDE_DOWN_DEG,
    ground_of,
)
from salsanext_cli.formats import format_of
from salsanext_cli.geometry.network_input import (
    BRIGHT,
    INTENSITY_FACTOR,
    NO_INTENSITY,
    why_no_intensity,
)
from salsanext_cli.geometry.projection import (
    ego_points,
    few_points,
    in_sensor_frame,
    measured_ranges,
)
from salsanext_cli.geometry.scan_traits import (
    MIN_TRAIT_POINTS,
    ScanTraits,
    sines_of,
    upper_intensity,
)
from salsanext_cli.records import Double, Float, Scan
from salsanext_cli.sensors.sensor import FITTED_NAME, OF_IMAGES, Sensor, presets


class Finding(NamedTuple):
    """Reason to doubt the labels of a scan."""

    code: str  # Name of the check, which stays; see warnings.md
    problem: str  # What is doubtful about this scan
    hint: str


@dataclass(frozen=True, slots=True)
class ScanCheck:
    """Result of a check: reasons to doubt the scan, and traits of its sensor."""

    findings: tuple[Finding, ...] = ()
    # None of a scan of fewer than `MIN_TRAIT_POINTS` points with a measurement
    traits: ScanTraits | None = None
    ego_share: float = 0.0  # Share of the points on the housing of the sensor or its vehicle, 0…1


UNCHECKED = ScanCheck()

MAX_USUAL_INTENSITY = 2.0  # Upper intensity of the scale 0…1, if that of training is unknown
APART = "label it by itself, into a folder of its own"
SCALE_IT = "set intensity_scale in a file for --sensor"
NAME_IT = (
    "if the files hold one, name its column, --columns x,y,z,_,intensity for example, or in the "
    "first line of text files; or set its scale, intensity_scale in a file for --sensor"
)
RENAME_IT = "if the files hold one of another name, rename that field to intensity"

MAX_SHARE_OUTSIDE = 0.2  # Most points outside without a warning; a matching sensor has 0.07
MEDIAN_RANGES_M = (0.3, 250.0)  # Possible median ranges of a scan in metres; real scans had 4 to 32
USUAL_RANGES_M = (60.0, 300.0)
"""Largest usual median range and 99 % quantile of ranges; real scans had up to 32 and 104."""
MIN_FAR_M = 15.0  # Least usual 99 % quantile of ranges; streets had 27 m, a room and a hall 8 and 9
MAX_VIEW_DEG = 120.0  # Largest usual field of view; that of sensors was 90° or less
MIN_MEASURED = 0.4  # Least usual share of measured points; organised clouds had 0.55 or more
MIN_ROWS, FEW_OF_ROW = 0.35, 0.1
"""Least usual share of the rows with points, more than a tenth of the average; those had 0.47."""
MIN_SHARE_OF_GROUND = 0.15  # Least share of the near points on a ground that gives reason to doubt
SECTORS = 64
MIN_SECTORS = 0.6  # Least share of the directions around with a point; revolutions had 0.89 or more
FEW_SECTORS = 0.1  # Least share of a sensor that looks one way; solid-state ones had 0.14 or more
FIT = "`salsanext inspect SCANS --fit sensor.toml`, then --sensor sensor.toml"
AUTO = "--sensor auto"
WRONG = "expect wrong labels"
ALONE = f"{WRONG}; if the other scans are of another sensor or mounting, {APART}"
FIT_CODES = frozenset({"out-of-view", "tilted", "upside-down"})  # Findings that a fit may remove
METRES = "convert them to metres"
COLUMNS = "name the columns: --columns x,y,z,intensity"  # For formats that do not name them
TRAIN = "expect worse labels, or `salsanext train` weights on scans of this sensor"
TRAIN_HERE = "expect worse labels, or `salsanext train` weights on scans of such places"
ORIGIN = "expect worse labels, or write the sensor's place as `origin` into a file for --sensor"


def training_findings(
    bright: float, reason: str, sensor: Sensor, trained: Sensor, name_it: str = NAME_IT
) -> Iterator[Finding]:
    """Compare images and their upper intensity with those of training; `reason`: why it is none."""
    if any(getattr(sensor, key) != getattr(trained, key) for key in OF_IMAGES):
        found = "the sensor file changes the size or normalisation of the images"
        hint = "accuracy drops: leave height, width, means and stds out of the file"
        yield Finding("other-images", found, hint)
    matched = sensor.intensity_quantiles
    can_match = trained.intensity_quantiles and not matched
    if reason:
        found = reason if matched else f"{reason}; the network takes it as it is"
        yield Finding("no-intensity", found, "--intensity none" if can_match else name_it)
        return
    if matched == NO_INTENSITY:
        return
    if bright < 0 and not matched:
        found = f"{BRIGHT:.0%} of the intensities are below {bright:.3g}: negative"
        hint = "name another column: --columns" + ", or --intensity none" * bool(can_match)
        yield Finding("intensity-scale", found, hint)
        return
    quantiles = matched or trained.intensity_quantiles
    if quantiles:
        usual = quantiles[round(BRIGHT * (len(quantiles) - 1))]
        near = usual / INTENSITY_FACTOR <= bright <= usual * INTENSITY_FACTOR
        doubtful = usual > 0 and not near  # Those below 0 have no factors.
        of = f"and {usual:.2g} in {'the scans fitted to' if matched else 'training'}"
    else:
        doubtful, of = bright > MAX_USUAL_INTENSITY, "where 0 to 1 is usual"
    if doubtful:
        found = f"{BRIGHT:.0%} of the intensities are below {bright:.3g}, {of}"
        scale = "--intensity auto, or " * bool(can_match) + SCALE_IT
        yield Finding("intensity-scale", found, APART if matched else scale)


def check_image(channels: Float, sensor: Sensor, trained: Sensor) -> ScanCheck:
    """Compare a range image (5, H, W) with training; its view was checked by `project`."""
    occupied = channels[:, channels[0] > 0]
    if occupied.shape[1] < MIN_TRAIT_POINTS:
        return UNCHECKED
    reason, bright = why_no_intensity(occupied[1:4].T, occupied[4]), upper_intensity(occupied[4])
    return ScanCheck(tuple(training_findings(bright, reason, sensor, trained)))


def share_outside(sines: npt.NDArray[np.floating[Any]], sensor: Sensor) -> float:
    """Return the share of sines of elevation (N,) above or below the field of view; 0 of none."""
    lowest, highest = np.sin(np.radians((sensor.fov_down, sensor.fov_up)))
    outside = (sines < lowest) | (sines > highest)
    return float(outside.mean()) if len(sines) else 0.0


def check_scan(
    path: Path, scan: Scan, sensor: Sensor, trained: Sensor | None = None, fit: str = ""
) -> ScanCheck:
    """Check a scan that is projected for a sensor, from some of its points.

    `path`: for errors; `trained`: sensor of the weights, if a network is to label the scan or to
    learn from it, so that the intensity matters; without quantiles it stands for 0 to 1; `fit`:
    advice for findings that a fit may remove.
    """
    some = in_sensor_frame(few_points(scan), sensor)
    ranges, measured = measured_ranges(some.points)
    if len(some) < len(scan) and measured.sum() < MIN_TRAIT_POINTS:
        some = in_sensor_frame(scan, sensor)
        ranges, measured = measured_ranges(some.points)
    _require_metres(path, len(scan), ranges[measured])
    own = ego_points(some.points, sensor)
    ego_share = len(own) / max(len(some), 1)
    if len(own):
        some = some.take(np.delete(np.arange(len(some)), own))
        ranges, measured = measured_ranges(some.points)
    if (count := int(measured.sum())) < MIN_TRAIT_POINTS:
        few = f"{counted(count, 'point')} with a measurement, too few to check"
        return ScanCheck((Finding("few-points", few, "give whole scans"),), None, ego_share)
    share, ranges = count / len(some), ranges[measured]
    some = Scan(some.points[measured], some.intensity[measured])
    sines = sines_of(some.points)
    reason = why_no_intensity(some.points, some.intensity)
    form = format_of(path.name)
    is_named = form is None or form.names_columns  # Recordings name their columns too.
    fit = fit or (FIT if sensor is trained else ALONE)
    if sensor.name not in (FITTED_NAME, *presets(), trained and trained.name):
        fit = AUTO
    findings = [
        *_of_units(ranges, share, sensor, is_named=is_named),
        *_of_view(some, sines, sensor, fit),
        *_of_ground(some, fit),
    ]
    bright = 0.0 if reason else upper_intensity(some.intensity)
    if trained is not None:
        name_it = RENAME_IT if is_named else NAME_IT
        findings += training_findings(bright, reason, sensor, trained, name_it)
    per_point = len(scan) * (1 - ego_share) * share / count
    traits = ScanTraits.of(sines, bright, per_point, sensor)
    return ScanCheck(tuple(findings), traits, ego_share)


def _require_metres(path: Path, count: int, ranges: Double) -> None:
    if count >= MIN_TRAIT_POINTS and not len(ranges):
        found = f"none of its {count} points is a measurement"
        raise FormatError(path, found, "finite coordinates around the sensor")
    if len(ranges) < MIN_TRAIT_POINTS:
        return
    median, (least, most) = float(np.median(ranges)), MEDIAN_RANGES_M
    if not least <= median <= most:
        expected = "coordinates in metres, with the sensor at the origin"
        hint = "convert millimetres or centimetres; take the sensor's place off map coordinates"
        raise FormatError(path, f"a median range of {median:.3g} m", expected, hint)


def _of_units(
    ranges: Double, measured: float, sensor: Sensor, *, is_named: bool
) -> Iterator[Finding]:
    median, far = np.quantile(ranges, (0.5, 0.99))
    if median > USUAL_RANGES_M[0] or far > USUAL_RANGES_M[1]:
        found = f"a median range of {median:.0f} m, and 1% of the points beyond {far:.0f} m"
        yield Finding("units", found, METRES if is_named else f"{METRES}, or {COLUMNS}")
    if far < MIN_FAR_M:
        found = f"99% of the points lie within {far:.0f} m, as in a room"
        yield Finding("indoor", found, TRAIN_HERE)
    if (view := sensor.fov_up - sensor.fov_down) > MAX_VIEW_DEG:
        found = f"the sensor has a field of view of {view:.0f}°"
        yield Finding("wide-view", found, "correct fov_up and fov_down, or --sensor auto")
    if measured < MIN_MEASURED:
        found = f"{1 - measured:.0%} of the points are no measurements"
        hint = "they stay unlabelled" if is_named else f"if they should be, {COLUMNS}"
        yield Finding("not-measured", found, hint)


def _of_view(scan: Scan, sines: Float, sensor: Sensor, fit: str) -> Iterator[Finding]:
    outside = share_outside(sines, sensor)
    if outside > MAX_SHARE_OUTSIDE:
        view = f"{sensor.name}, {sensor.fov_up:+g}° to {sensor.fov_down:+g}°"
        found = f"{outside:.0%} of the points lie outside the view of {view}"
        yield Finding("out-of-view", found, fit)
    turns = np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2 * np.pi) + 0.5
    around = float((np.bincount((turns * SECTORS).astype(int) % SECTORS) > 0).sum()) / SECTORS
    if around < MIN_SECTORS:
        code = "part-of-circle" if around >= FEW_SECTORS else "few-directions"
        yield Finding(code, f"points in {around:.0%} of the directions around", TRAIN)
    downwards = sensor.fov_up - np.degrees(np.arcsin(sines))
    rows = (downwards * (sensor.height / (sensor.fov_up - sensor.fov_down))).astype(int)
    per_row = np.bincount(rows.clip(0, sensor.height - 1), minlength=sensor.height)
    occupied = float((per_row > FEW_OF_ROW * per_row.mean()).mean())
    if occupied < MIN_ROWS and outside <= MAX_SHARE_OUTSIDE:
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
        yield Finding("height", found, ORIGIN)
