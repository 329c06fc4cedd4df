# SPDX-License-Identifier: MIT
"""Checks of what no single LiDAR sees on a clear day, by the points alone.

They do not depend on the confidence of weights, which can be high on a ruined scan.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.scan_structure import structure_of
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.geometry.beam_origin import sharpness
from salsanext_cli.core.geometry.sectors import occupied_sectors
from salsanext_cli.core.records import FileNotes, Float, Scan
from salsanext_cli.core.sensors.sensor import ORIGIN, UP, Sensor
from salsanext_cli.core.texts import percentage
from salsanext_cli.core.wording import argument

MAX_HIDDEN = 0.045
"""Largest share of hidden points; single scans had up to 0.037, ten scans in one 0.062 or more."""
MIN_STILL_HIDDEN = 0.4
"""Least share of the points hidden from the origin of a file that several scans in one still hide
from a position fitted to them, 0.6; scans that were moved had up to 0.21."""
MAX_HIDDEN_IN_FOG = 0.09
"""The same of points of which some float: those of single scans in fog and snow were 0.065."""
MAX_ROUGHNESS = 0.015
"""Largest relative deviation of neighbouring ranges; scans had up to 0.008, with noise of 0.1 m
0.023 or more."""
MAX_IN_AIR = 0.007
"""Largest share of points in the air; scans had up to 0.004, in light fog and snow 0.009."""
MAX_SECTORS = 0.6  # Largest share of the directions around with a point of a depth image
MIN_SHARPNESS = 2.0
"""Least sharpness of the rows of a sensor with few directions; a depth image had up to 1.5."""
FUSION_HINT = "label the single scans, then `salsanext fuse`"
SINGLE_SCAN_HINT = (
    "if it is a single scan, keep one return of each pulse, or set the `origin` of its sensor"
)
NOISE_HINT = "expect wrong labels: remove such points, or `salsanext train` weights on such scans"
ROTATING_SENSOR_HINT = "expect wrong labels: the weights know scans of rotating sensors"


def structure_findings(scan: Scan, sensor: Sensor) -> Iterator[Finding]:
    """Yield signs of noise, of fog and snow, and of several scans in one."""
    structure = structure_of(scan, sensor)
    if structure is None:
        return
    # Noise also lets points float and hides others; fog hides points, too. In several scans at
    # once, the vehicles that carried the sensor float.
    if structure.roughness > MAX_ROUGHNESS:
        problem = f"neighbouring ranges differ by {percentage(structure.roughness)}, as by noise"
        yield Finding(WarningCode.NOISY, f"{problem} or in dense fog", NOISE_HINT)
    elif structure.in_air > MAX_IN_AIR and structure.hidden <= MAX_HIDDEN_IN_FOG:
        problem = (
            f"{percentage(structure.in_air)} of the points float near the sensor, as in fog or snow"
        )
        yield Finding(WarningCode.NEAR_RETURNS, problem, NOISE_HINT)
    else:
        yield from _accumulated_findings(structure.hidden, scan.notes)


def accumulated_from_file(scan: Scan, sensor: Sensor) -> Iterator[Finding]:
    """Yield a sign of several scans in one that shows from the origin of the file alone.

    The position that was fitted to several scans in one is the one that sees the fewest points
    behind others. A single scan that is seen from there hides hardly any.
    """
    fitted = structure_of(scan, sensor)
    if fitted is None or fitted.hidden < MIN_STILL_HIDDEN * MAX_HIDDEN:
        return
    in_file = replace(sensor, origin=ORIGIN, up=UP)
    structure = structure_of(scan, in_file)
    if structure is not None and fitted.hidden >= MIN_STILL_HIDDEN * structure.hidden:
        findings = structure_findings(scan, in_file)
        yield from (finding for finding in findings if finding.code == WarningCode.ACCUMULATED)


def survey_hint() -> str:
    """Return what helps to label a cloud without a sensor."""
    return (
        "label its single scans, with the trajectory of the sensor in a poses.txt next to them; or "
        f"state a position that sees the points with {argument('origin')}"
    )


def _accumulated_findings(hidden: float, notes: FileNotes) -> Iterator[Finding]:
    split = notes.split
    several_sensors = split is not None and split.kind == "sensor"
    if hidden > MAX_HIDDEN:
        problem = f"{percentage(hidden)} of the points lie more than a metre behind others"
        origin = "sensors" if several_sensors else "scans"
        yield Finding(
            WarningCode.ACCUMULATED, f"{problem}, as in several {origin} at once", _remedy(notes)
        )
    elif split is not None and several_sensors:
        problem = f"has the points of {split.count} sensors, by its field {split.field}"
        yield Finding(WarningCode.ACCUMULATED, problem, _remedy(notes))


def _remedy(notes: FileNotes) -> str:
    split = notes.split
    if split is None and notes.frame != ORIGIN:
        return survey_hint()
    if split is None:
        return f"{FUSION_HINT}; {SINGLE_SCAN_HINT}"
    values = f"its field {split.field} has {split.count} values"
    if split.kind == "sensor":
        return f"{values}: split the file by it, and label each sensor in a folder of its own"
    if split.kind == "scan":
        return f"{values}: split the file by it, then {FUSION_HINT}"
    return f"split the file by the times of its field {split.field}, then {FUSION_HINT}"


def depth_image_findings(points: Float, no_intensity: str) -> Iterator[Finding]:
    """Yield a sign that measured points (N, 3) are of a depth image.

    `no_intensity` states why the values are not intensities; empty if they are.
    """
    if not no_intensity:
        return
    share = occupied_sectors(points)
    if share < MAX_SECTORS and sharpness(points.astype(np.float64), np.zeros(3)) < MIN_SHARPNESS:
        problem = f"no intensities, no rows, and {percentage(share, 0)} of the directions around"
        yield Finding(
            WarningCode.DEPTH_IMAGE, f"has {problem}, as a depth image", ROTATING_SENSOR_HINT
        )
