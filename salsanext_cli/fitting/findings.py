# SPDX-License-Identifier: MIT
"""Result of checking a scan."""

from dataclasses import dataclass

import numpy as np

from salsanext_cli.records import Float

NODES_DEG = (-30.0, -20.0, -12.0, -6.0, -3.0)
"""Elevations between which points are counted. Below them every beam meets the ground, wherever the
sensor is; above, it may meet the sky."""
VIEW = (0.01, 0.99)
"""Quantiles of the elevation that describe a view."""
MIN_POINTS = 100
"""Fewest points of which a check says something."""


@dataclass(frozen=True, slots=True)
class ScanTraits:
    """Traits of the sensor in one scan, estimated from a sample of its points."""

    points: int  # Number of points with a measurement
    fov_up: float  # Elevations in degrees that few points lie above and below
    fov_down: float
    # Number of points around each of `NODES_DEG` but the last, which counts none
    below: tuple[float, ...]
    bright: float  # Upper intensity; 0 if unknown


def traits_of(sines: Float, bright: float, per_point: float) -> ScanTraits:
    """Return the traits of a scan.

    Points between two nodes count for both by their distance, so that a beam that lies at one, or
    is measured a little higher or lower, makes no difference.

    `sines` (M,) float32, sines of elevation of a sample of the points with a measurement; `bright`:
    upper intensity of the scan; `per_point`: points of the scan for each of the sample.
    """
    elevations = np.degrees(np.arcsin(sines))
    down, up = np.quantile(elevations, VIEW)
    below = [np.interp(elevations, NODES_DEG, hat).sum() for hat in np.eye(len(NODES_DEG))[:-1]]
    return ScanTraits(
        points=round(len(sines) * per_point),
        fov_up=round(float(up), 2),
        fov_down=round(float(down), 2),
        below=tuple(round(float(count) * per_point, 1) for count in below),
        bright=round(bright, 6),
    )


@dataclass(frozen=True, slots=True)
class Finding:
    """Reason to doubt the labels of a scan."""

    code: str  # Name of the check, which stays; see docs/checks.md
    found: str  # What is doubtful about this scan, and what to do
    remedy: str


@dataclass(frozen=True, slots=True)
class ScanCheck:
    """Result of a check: reasons to doubt the scan, and traits of its sensor."""

    findings: tuple[Finding, ...] = ()
    # None of a scan of fewer than `MIN_POINTS` points with a measurement
    traits: ScanTraits | None = None
    ego_share: float = 0.0  # Share of the points on the housing of the sensor or its vehicle, 0…1


UNCHECKED = ScanCheck()
