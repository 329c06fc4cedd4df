# SPDX-License-Identifier: MIT
"""Survey of a set of scans: field of view, normalisation, classes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields
from operator import add
from typing import Any

import numpy as np

from salsanext_cli.core.classes.label_space import RawIds
from salsanext_cli.core.fitting.field_of_view import OUTLIERS
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.measures.scores import Counts, Ratios
from salsanext_cli.core.records import CHANNELS, RangeImage, Scan

ELEVATION_STEP_DEG = 0.05
ELEVATION_BINS = round(180 / ELEVATION_STEP_DEG)
EXTREMES = {"smallest": min, "largest": max, "farthest": max, "brightest": max}
"""Fields of a survey that are not added up."""


@dataclass(slots=True, kw_only=True)
class Survey:
    """Running counts over scans; adding two gives the counts of both."""

    scans: int = 0
    labelled: int = 0  # Scans with labels
    points: int = 0
    invalid: int = 0  # Points without a measurement (origin, NaN, infinite)
    smallest: int = np.iinfo(np.int64).max  # Fewest points of a scan
    largest: int = 0  # Most points of a scan
    farthest: float = 0.0  # Largest range in metres
    brightest: float = 0.0  # Largest intensity
    # (ELEVATION_BINS,) int64: points by elevation from -90° to 90°
    elevations: Counts = field(default_factory=lambda: np.zeros(ELEVATION_BINS, np.int64))
    pixels: int = 0  # Occupied pixels of the range images
    # (5,) float64: sums of each channel over occupied pixels
    sums: Ratios = field(default_factory=lambda: np.zeros(len(CHANNELS)))
    # (5,) float64: sums of its square over occupied pixels
    squares: Ratios = field(default_factory=lambda: np.zeros(len(CHANNELS)))
    classes: Counter[int] = field(default_factory=Counter)  # Points by raw id, without instance

    def __add__(self, other: Survey) -> Survey:
        values: dict[str, Any] = {}
        for name in (counted.name for counted in fields(self)):
            combine = EXTREMES.get(name, add)
            values[name] = combine(getattr(self, name), getattr(other, name))
        return Survey(**values)

    @property
    def means(self) -> tuple[float, ...]:
        """Mean of each channel over occupied pixels; 0 without any."""
        return tuple(float(mean) for mean in self.sums / max(self.pixels, 1))

    @property
    def stds(self) -> tuple[float, ...]:
        """Standard deviation of each channel over occupied pixels; 1 where nothing varies."""
        variances = self.squares / max(self.pixels, 1) - np.square(self.means)
        return tuple(float(np.sqrt(v)) if v > 0 else 1.0 for v in variances)

    def field_of_view(self) -> tuple[float, float]:
        """Return the upper and lower edge in degrees, without `OUTLIERS` on either side."""
        cumulated = np.cumsum(self.elevations) / max(self.elevations.sum(), 1)
        lowest = int(np.searchsorted(cumulated, OUTLIERS))
        highest = int(np.searchsorted(cumulated, 1 - OUTLIERS)) + 1
        return highest * ELEVATION_STEP_DEG - 90, lowest * ELEVATION_STEP_DEG - 90

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        up, down = self.field_of_view()
        return {
            "scans": self.scans,
            "labelled": self.labelled,
            "points": self.points,
            "points_per_scan": [min(self.smallest, self.largest), self.largest],
            "invalid_points": self.invalid,
            "farthest": round(self.farthest, 3),
            "brightest": round(self.brightest, 4),
            "fov_up": round(up, 2),
            "fov_down": round(down, 2),
            "occupied_pixels": self.pixels,
            "means": [round(mean, 4) for mean in self.means],
            "stds": [round(std, 4) for std in self.stds],
            "classes": {str(i): count for i, count in sorted(self.classes.items())},
        }


def survey(scan: Scan, image: RangeImage, raw: RawIds | None) -> Survey:
    """Count one scan.

    Parameters
    ----------
    scan : Scan
        N points in the frame of their file.
    image : RangeImage
        Its range image.
    raw : (N,) uint32, optional
        Raw ids of its labels.

    Returns
    -------
    Survey
    """
    ranges, measured = measured_ranges(scan.points)
    ranges = ranges[measured]
    z = scan.points[measured, 2]
    elevations = np.degrees(np.arcsin(z / ranges))
    occupied = image.channels[:, image.channels[0] > 0].astype(np.float64)
    bright = scan.intensity[np.isfinite(scan.intensity)]
    classes: RawIds | list[int] = [] if raw is None else raw & np.uint32(0xFFFF)
    ids, counts = np.unique(classes, return_counts=True)
    return Survey(
        scans=1,
        labelled=int(raw is not None),
        points=len(scan),
        invalid=int(len(scan) - measured.sum()),
        smallest=len(scan),
        largest=len(scan),
        farthest=float(ranges.max(initial=0)),
        brightest=float(bright.max(initial=0)),
        elevations=np.histogram(elevations, ELEVATION_BINS, (-90, 90))[0].astype(np.int64),
        pixels=occupied.shape[1],
        sums=occupied.sum(axis=1),
        squares=np.square(occupied).sum(axis=1),
        classes=Counter({int(i): int(n) for i, n in zip(ids, counts, strict=True)}),
    )
