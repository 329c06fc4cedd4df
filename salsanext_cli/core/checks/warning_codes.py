# SPDX-License-Identifier: MIT
"""Codes of all warnings about scans; docs/reference/warnings.md has thresholds and remedies.

A warning is printed as the problem and the hint of its `Finding`, in the module that finds it:
those of `core/checks/` for one scan, of `runs/fit/`, `runs/drives/` and `runs/summary/` for a run.
`core/measures/decision.py` has what a code means for the decision on the weights, and
`core/measures/expected_accuracy.py` what else withholds the estimated accuracy of a run.
"""

from __future__ import annotations

from enum import StrEnum


class WarningCode(StrEnum):
    """Code of a warning; records and `--json` contain its text.

    Attributes
    ----------
    meaning : str
        One line for the table of the documentation.
    withholds_estimate : bool
        Whether no accuracy is estimated for a scan with the warning, since it is unlike the drives
        that the estimate was judged on. `MIXED_SENSORS` withholds the estimate of the whole run.
    """

    meaning: str
    withholds_estimate: bool

    def __new__(cls, code: str, meaning: str, withholds_estimate: bool = True) -> WarningCode:
        """Make a member whose value is the code alone."""
        member = str.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        member.withholds_estimate = withholds_estimate
        return member

    FEW_POINTS = "few-points", "few measured points; nothing else is checked"
    MISSING_POINTS = "missing-points", "the file has fewer points than its header states"
    UNITS = "units", "large ranges"
    INDOOR = "indoor", "small ranges, as in a room"
    NOT_MEASURED = "not-measured", "points without a measurement"
    OUT_OF_VIEW = "out-of-view", "points outside the field of view"
    # Solid-state sensors, which only get this warning, had the estimate within 3 percentage points.
    PART_OF_CIRCLE = "part-of-circle", "points in a part of the directions", False
    FEW_DIRECTIONS = "few-directions", "points in very few directions"
    SPARSE = "sparse", "few rows of the image have points"
    UPSIDE_DOWN = "upside-down", "the ground lies above the sensor"
    TILTED = "tilted", "the ground is tilted"
    HEIGHT = "height", "unusual height of the origin above the ground"
    ACCUMULATED = (
        "accumulated",
        "points behind all surfaces around: several scans, several sensors, or another origin",
    )
    NOISY = "noisy", "neighbouring ranges differ: noise, or dense fog"
    NEAR_RETURNS = "near-returns", "points in the air near the sensor: fog or snow"
    DEPTH_IMAGE = "depth-image", "no intensity, no rows, and a part of the circle: a depth image"
    OUT_OF_PLACE = "out-of-place", "the points are seen from elsewhere than the origin"
    NO_INTENSITY = "no-intensity", "no usable intensity", False
    INTENSITY_SCALE = "intensity-scale", "unusual scale of the intensity", False
    OTHER_IMAGES = "other-images", "images of another size or normalisation than in training"
    MIXED_SENSORS = "mixed-sensors", "a scan is of another sensor than the others"
    OTHER_SCANS = (
        "other-scans",
        "the scans are unlike those that the threshold of a guarantee was chosen on",
        False,
    )
    CONSECUTIVE = (
        "consecutive",
        "a guarantee counts scans, and most of them follow each other",
        False,
    )
    SEEN_BY_FIT = (
        "seen-by-fit",
        "the error model of a guarantee was fitted to the same sequences",
        False,
    )
    APART = "apart", "`fuse` divides a sequence into parts", False
    ONE_CLASS = (
        "one-class",
        "one class takes most of the labelled points, before labels are rejected",
    )
    LOW_CONFIDENCE = "low-confidence", "the network is unsure everywhere"
