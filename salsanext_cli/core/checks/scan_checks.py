# SPDX-License-Identifier: MIT
"""Checks of scans, by a sample of their points: units, mounting, field of view, intensity, sensor.

A certain mistake is an error of the scan. A reason to doubt the labels is a finding, which becomes
a warning of the run. docs/reference/warnings.md explains the thresholds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.checks.check_sample import check_sample
from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.place_checks import (
    HINT_DIGITS,
    MIN_SHARE_OF_GROUND,
    PlaceProblem,
    lines_of_place,
    place_problem,
    shows_beams,
)
from salsanext_cli.core.checks.structure_checks import (
    accumulated_from_file,
    depth_image_findings,
    structure_findings,
)
from salsanext_cli.core.checks.training_checks import SEPARATE_RUN_HINT, training_findings
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.geometry.ground import (
    MAX_TILT_DEG,
    TOLERANCE_M,
    UPSIDE_DOWN_DEG,
    Ground,
    ground_of,
)
from salsanext_cli.core.geometry.scan_traits import (
    MIN_TRAIT_POINTS,
    ScanTraits,
    intensity_of,
    sines_of,
)
from salsanext_cli.core.geometry.sectors import occupied_sectors
from salsanext_cli.core.geometry.sensor_place import USUAL_HEIGHT_M, origin_in_file
from salsanext_cli.core.records import Double, FileNotes, Float, Scan
from salsanext_cli.core.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor, presets
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.core.wording import argument, command, setting

MAX_SHARE_OUTSIDE = 0.2  # Most points outside without a warning; a matching sensor has 0.07
USUAL_RANGES_M = (60.0, 300.0)
"""Largest usual median range and 99 % quantile of ranges; real scans had up to 32 and 104."""
MIN_FAR_M = 15.0  # Least usual 99 % quantile of ranges; roads had 27 m, a room and a hall 8 and 9
MIN_MEASURED = 0.4  # Least usual share of measured points; organised clouds had 0.55 or more
FEW_OF_ROW = 0.1  # Least share of the mean points of a row in a row that counts
MIN_ROWS = 0.35  # Least usual share of rows that count; scans had 0.47 or more
MIN_SECTORS = 0.6  # Least share of the directions around with a point; revolutions had 0.89 or more
FEW_SECTORS = 0.1  # The same for a narrow field of view; solid-state sensors had 0.14 or more

OTHER_SENSOR_HINT = (
    "expect wrong labels; if the other scans are of another sensor or mounting, "
    f"{SEPARATE_RUN_HINT}"
)
POSE_HINT = "expect wrong labels: correct its pose, or `salsanext predict` this scan alone"
TRAINING_HINT = "expect worse labels, or `salsanext train` weights on such scans"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanCheck:
    """Result of a check: reasons to doubt the scan, and traits of its sensor."""

    findings: tuple[Finding, ...] = ()
    traits: ScanTraits | None = None  # None for fewer than `MIN_TRAIT_POINTS` measured points
    points: int = 0  # Number of points of the scan; 0 unless `project_scan` counted them
    ego_points: int = 0  # Number of these on the housing of the sensor or its vehicle


UNCHECKED = ScanCheck()


def origin_hint() -> str:
    """Return the hint to state the position of the sensor."""
    place = f"the position of the sensor as `origin` into a file for {argument('sensor')}"
    return f"expect worse labels, or write {place}"


def fit_hint() -> str:
    """Return the hint to fit the sensor to all scans."""
    fitted = command("salsanext inspect SCANS", setting("fit", "sensor.toml"))
    return f"`{fitted}`, then {setting('sensor', 'sensor.toml')}"


def columns_hint() -> str:
    """Return the hint to name columns."""
    return f"name the columns of files without names: {setting('columns', 'x,y,z,intensity')}"


def check_image(channels: Float, sensor: Sensor, trained: Sensor) -> ScanCheck:
    """Compare a range image with training; `project` checked its field of view.

    Parameters
    ----------
    channels : (5, H, W) float32
        Range image.
    sensor : Sensor
        Sensor of the image.
    trained : Sensor
        Sensor of the weights.

    Returns
    -------
    ScanCheck
    """
    occupied = channels[:, channels[0] > 0]
    if occupied.shape[1] < MIN_TRAIT_POINTS:
        return UNCHECKED
    reason, bright = intensity_of(occupied[1:4].T, occupied[4])
    return ScanCheck(findings=tuple(training_findings(bright, reason, sensor, trained)))


def share_outside(sines: npt.NDArray[np.floating[Any]], sensor: Sensor) -> float:
    """Return the share of sines of elevation (N,) outside the field of view, 0 without any."""
    lowest, highest = np.sin(np.radians((sensor.fov_down, sensor.fov_up)))
    outside = (sines < lowest) | (sines > highest)
    return float(outside.mean()) if len(sines) else 0.0


def check_scan(
    source: object, scan: Scan, sensor: Sensor, trained: Sensor | None = None, fit: str = ""
) -> ScanCheck:
    """Check a sample of the points of a scan that is projected for a sensor.

    Parameters
    ----------
    source : object
        Name of the scan in errors.
    scan : Scan
        N points in the frame of their file.
    sensor : Sensor
        Sensor that the scan is projected for.
    trained : Sensor, optional
        Sensor of the weights, if the intensity matters; without quantiles it stands for 0 to 1.
    fit : str
        Hint about a wrong field of view or mounting, if a fit of the sensor may help.

    Returns
    -------
    ScanCheck

    Raises
    ------
    FormatError
        If the points are not in metres around a sensor.
    """
    sample = check_sample(source, scan, sensor)
    measured = sample.measured
    if len(measured) < MIN_TRAIT_POINTS:
        problem = f"has {counted(len(measured), 'point')} with a measurement, too few to check"
        return ScanCheck(findings=(Finding(WarningCode.FEW_POINTS, problem, "give whole scans"),))
    sines = sines_of(measured.points)
    no_intensity, bright = intensity_of(measured.points, measured.intensity)
    findings = [
        *_file_findings(scan.notes),
        *_unit_findings(sample.ranges, sample.measured_share, scan.notes),
        *_mounting_findings(scan, measured, sines, sensor, _fit_hint(sensor, trained, fit)),
        *depth_image_findings(measured.points, no_intensity),
    ]
    if trained is not None:
        findings += training_findings(bright, no_intensity, sensor, trained, scan.notes.fields)
    measured_points = len(scan) * (1 - sample.ego_share) * sample.measured_share
    per_point = measured_points / len(measured)
    # The scans of one sensor are compared, also if each has its own origin.
    fitted = replace(sensor, origin=ORIGIN) if sensor.registered else sensor
    traits = ScanTraits.from_sines(sines, bright, per_point, fitted)
    return ScanCheck(findings=tuple(findings), traits=traits)


def _fit_hint(sensor: Sensor, trained: Sensor | None, fit: str) -> str:
    """Return the hint about a fit of the sensor, which is `fit` if that may help."""
    if sensor.name not in (FITTED_NAME, *presets(), trained and trained.name):
        return setting("sensor", "auto")
    if sensor.registered:  # A fit to all scans, or a position of all, does not help one of them.
        return POSE_HINT
    return fit or (fit_hint() if sensor is trained else OTHER_SENSOR_HINT)


def _mounting_findings(
    scan: Scan, measured: Scan, sines: Float, sensor: Sensor, fit: str
) -> Iterator[Finding]:
    """Yield doubts about field of view, position, ground and structure, in this order.

    `measured` are measured points in the frame of the sensor, `sines` those of their elevations.
    """
    ground = ground_of(measured)
    checked = _place_check(scan, measured, ground, sensor)
    yield from _view_findings(measured, sines, sensor, fit)
    yield from _place_findings(checked.problem, sensor, fit)
    if checked.problem is None:
        yield from _ground_findings(ground, sensor, fit)
    yield from checked.structure


@dataclass(frozen=True, slots=True, kw_only=True)
class _PlaceCheck:
    """Doubts about the position of a sensor, and about the structure that is seen from there."""

    problem: PlaceProblem | None
    structure: tuple[Finding, ...]


def _place_check(scan: Scan, measured: Scan, ground: Ground | None, sensor: Sensor) -> _PlaceCheck:
    """Check the position of a sensor, and the structure of its scan; `ground` is of `measured`."""
    checked = _structure_at_place(scan, sensor, place_problem(scan, measured, ground, sensor))
    is_moved = sensor.name == FITTED_NAME and sensor.origin != ORIGIN and not sensor.registered
    if not is_moved or _accumulated(checked.structure) or shows_beams(scan, ground, sensor):
        return checked
    from_file = accumulated_from_file(scan, sensor)
    return replace(checked, structure=(*checked.structure, *from_file))


def _structure_at_place(scan: Scan, sensor: Sensor, problem: PlaceProblem | None) -> _PlaceCheck:
    """Return the signs in the structure of a scan, and what remains of the problem of its place."""
    at_place = problem.sensor if problem and problem.sensor else sensor
    structure = tuple(structure_findings(scan, at_place))
    if _accumulated(structure):
        # Several positions have seen the points: no other one has seen all.
        return _PlaceCheck(problem=None, structure=structure)
    if problem is None or problem.sensor is not None:
        return _PlaceCheck(problem=problem, structure=structure)
    # Seen from elsewhere, any scan looks noisy. The position that was fitted to several scans in
    # one is the one that sees the fewest of them behind others.
    in_file = replace(sensor, origin=ORIGIN, up=UP)
    accumulated = _accumulated(structure_findings(scan, in_file))
    return _PlaceCheck(problem=problem, structure=tuple(accumulated))


def _accumulated(findings: Iterable[Finding]) -> list[Finding]:
    """Return the findings of several scans in one."""
    return [finding for finding in findings if finding.code == WarningCode.ACCUMULATED]


def _file_findings(notes: FileNotes) -> Iterator[Finding]:
    """Yield the doubt about a file with fewer points than it states."""
    if notes.missing_points:
        problem = f"lacks {counted(notes.missing_points, 'point')} of those in its header"
        yield Finding(WarningCode.MISSING_POINTS, problem, "the file may be cut off: copy it again")


def _unit_findings(ranges: Double, measured_share: float, notes: FileNotes) -> Iterator[Finding]:
    """Yield doubts about ranges (M,) in metres, and about the share of points that have one."""
    median, far = np.quantile(ranges, (0.5, 0.99))
    if median > USUAL_RANGES_M[0] or far > USUAL_RANGES_M[1]:
        problem = f"has a median range of {median:.0f} m, and 1 % of the points beyond {far:.0f} m"
        hint = f"convert them to metres, or {columns_hint()}"
        if notes.frame != ORIGIN:
            hint = f"cut the file to about {USUAL_RANGES_M[1]:.0f} m around the sensor"
        yield Finding(WarningCode.UNITS, problem, hint)
    if far < MIN_FAR_M:
        yield Finding(
            WarningCode.INDOOR,
            f"99 % of the points lie within {far:.0f} m, as in a room",
            TRAINING_HINT,
        )
    if measured_share < MIN_MEASURED:
        problem = f"{percentage(1 - measured_share, 0)} of the points are not measurements"
        hint = f"they stay unlabelled; if they should not, {columns_hint()}"
        yield Finding(WarningCode.NOT_MEASURED, problem, hint)


def _view_findings(scan: Scan, sines: Float, sensor: Sensor, fit: str) -> Iterator[Finding]:
    """Yield doubts about the directions of the points: outside the view, few around, few rows."""
    outside = share_outside(sines, sensor)
    if outside > MAX_SHARE_OUTSIDE:
        view = f"{sensor.name}, {sensor.fov_up:+g}° to {sensor.fov_down:+g}°"
        problem = f"{percentage(outside, 0)} of the points lie outside the field of view of {view}"
        yield Finding(WarningCode.OUT_OF_VIEW, problem, fit)
    around = occupied_sectors(scan.points)
    if around < MIN_SECTORS:
        is_wide = around >= FEW_SECTORS
        code = WarningCode.PART_OF_CIRCLE if is_wide else WarningCode.FEW_DIRECTIONS
        yield Finding(
            code, f"has points in {percentage(around, 0)} of the directions around", TRAINING_HINT
        )
    downwards = sensor.fov_up - np.degrees(np.arcsin(sines))
    rows = (downwards * (sensor.height / (sensor.fov_up - sensor.fov_down))).astype(int)
    per_row = np.bincount(rows.clip(0, sensor.height - 1), minlength=sensor.height)
    occupied = float((per_row > FEW_OF_ROW * per_row.mean()).mean())
    if occupied < MIN_ROWS and outside <= MAX_SHARE_OUTSIDE:
        problem = (
            f"has points in {percentage(occupied, 0)} of the {sensor.height} rows of the image"
        )
        yield Finding(WarningCode.SPARSE, problem, TRAINING_HINT)


def _ground_findings(ground: Ground | None, sensor: Sensor, fit: str) -> Iterator[Finding]:
    """Yield the doubt about a ground that is above the sensor, tilted or at an unusual height."""
    if ground is None or ground.share < MIN_SHARE_OF_GROUND:
        return
    if ground.tilt_deg > UPSIDE_DOWN_DEG:
        yield Finding(WarningCode.UPSIDE_DOWN, "the ground lies above the sensor", fit)
    elif ground.tilt_deg > MAX_TILT_DEG:
        yield Finding(WarningCode.TILTED, f"the ground is tilted by {ground.tilt_deg:.0f}°", fit)
    elif not ground.is_usual:
        where = "above" if ground.height > 0 else "below"
        on_it = abs(ground.height) < TOLERANCE_M
        height = "on" if on_it else f"{abs(ground.height):.1f} m {where}"
        hint = POSE_HINT if sensor.registered else _raised(ground, sensor)
        yield Finding(WarningCode.HEIGHT, f"the origin of the points is {height} the ground", hint)


def _raised(ground: Ground, sensor: Sensor) -> str:
    """Return the hint to place a sensor at the usual height above its ground."""
    position = np.array([0, 0, USUAL_HEIGHT_M - ground.height])
    raised = replace(sensor, origin=origin_in_file(position, sensor, HINT_DIGITS))
    place = f"{lines_of_place(raised)} ({USUAL_HEIGHT_M:g} m above the ground)"
    return f"expect worse labels, or write {place} into a file for {argument('sensor')}"


def _place_findings(misplaced: PlaceProblem | None, sensor: Sensor, fit: str) -> Iterator[Finding]:
    """Yield the doubt about the position of the sensor."""
    if misplaced is None:
        return
    hint = origin_hint()
    if sensor.registered:
        hint = POSE_HINT
    elif misplaced.remedy:
        hint = f"{fit}, or write {misplaced.remedy} into a file for {argument('sensor')}"
    yield Finding(WarningCode.OUT_OF_PLACE, misplaced.problem, hint)
