# SPDX-License-Identifier: MIT
"""Traits of a scan that depend on its sensor and hardly on the place, and the sensor by them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.geometry.network_input import BRIGHT, INTENSITY_FACTOR, why_no_intensity
from salsanext_cli.geometry.projection import few_points, measured_ranges
from salsanext_cli.records import Double, Float, Indices, Scan
from salsanext_cli.sensors.sensor import Sensor

NODES_DEG = (-30.0, -20.0, -12.0, -6.0, -3.0)
"""Elevations between which points are counted. Below them every beam meets the ground, wherever the
sensor is; above, it may meet the sky."""
VIEW = (0.01, 0.99)  # Quantiles of the elevation that describe a field of view
SECTORS = 64  # Directions around
MIN_TRAIT_POINTS = 100  # Fewest points with a measurement that show traits
DENSITY_FACTOR = 1.5
"""Least factor between the numbers of points that two sensors have around an elevation; scans of
one sensor had up to 1.27, the two most similar sensors 1.77."""
POINTS_FACTOR = 4.0  # The same for all their points, of which the sky leaves more or less
SHARES_FACTOR = 1.35
"""Largest factor between the shares of the points that two scans of one sensor have around an
elevation, of which one is cut off or thinned out; two sensors had 1.4 or more."""
FACTORS = (
    *[DENSITY_FACTOR] * (len(NODES_DEG) - 1),
    *(POINTS_FACTOR, INTENSITY_FACTOR),
    *[SHARES_FACTOR] * (len(NODES_DEG) - 1),
)
DIGITS = 6
SHARES = len(NODES_DEG) + 1  # Index of the first share among `FACTORS`
MIN_SHARE = 0.02
"""Points around an elevation, as a share of all of the scan, up to which they do not count."""


@dataclass(frozen=True, slots=True)
class ScanTraits:
    """Traits of the sensor in one scan, estimated from a sample of its points.

    Points between two nodes count for both by their distance, so that a beam that lies at one, or
    is measured a little higher or lower, makes no difference.
    """

    points: int  # Number of points with a measurement
    fov_up: float  # Elevations in degrees that few points lie above and below
    fov_down: float
    # Number of points around each of `NODES_DEG` but the last, which counts none
    below: tuple[float, ...]
    bright: float  # Upper intensity; 0 if unknown
    sensor: Sensor | None = None  # Sensor that was fitted to the scan

    @classmethod
    def of(
        cls, points: Float, bright: float, per_point: float, sensor: Sensor | None = None
    ) -> ScanTraits:
        """Return the traits of measured points (M, 3) that stand for `per_point` points each."""
        elevations = np.degrees(np.arcsin(sines_of(points)))
        down, up = np.quantile(elevations, VIEW)
        hats = np.eye(len(NODES_DEG))[:-1]
        below = [np.interp(elevations, NODES_DEG, hat).sum() * per_point for hat in hats]
        return cls(
            points=round(len(points) * per_point),
            fov_up=round(float(up), 2),
            fov_down=round(float(down), 2),
            below=tuple(round(float(count), 1) for count in below),
            bright=round(bright, DIGITS),
            sensor=sensor,
        )

    @property
    def compared(self) -> tuple[float, ...]:
        """Numbers that tell sensors apart, as `FACTORS`."""
        return *self.below, float(self.points), self.bright

    def __str__(self) -> str:
        """Describe the scan: ``92,677 points, +8° to -25°, intensities to 158``."""
        view = f"{self.fov_up:+.0f}° to {self.fov_down:+.0f}°"
        bright = f", intensities to {self.bright:.2g}" if self.bright else ""
        return f"{self.points:,} points, {view}{bright}"


def sines_of(points: Float) -> Float:
    """Return the sines of elevation of points (N, 3), (N,)."""
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    return (points[:, 2] / np.maximum(ranges, np.finfo(np.float32).tiny)).clip(-1, 1)


def share_around(points: Float) -> float:
    """Return the share of `SECTORS` directions around that hold one of the points (N, 3)."""
    turns = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5
    return float((np.bincount((turns * SECTORS).astype(int) % SECTORS) > 0).sum()) / SECTORS


def upper_intensity(intensity: Float) -> float:
    """Return the upper intensity of those that are numbers, 0 without any."""
    finite = intensity[np.isfinite(intensity)]
    return float(np.quantile(finite, BRIGHT)) if len(finite) else 0.0


def traits_of(scan: Scan) -> ScanTraits | None:
    """Return the traits of a scan as its file holds it, None of too few measured points."""
    some = few_points(scan)
    measured = np.flatnonzero(measured_ranges(some.points)[1])
    if len(measured) < MIN_TRAIT_POINTS:
        return None
    per_point, some = len(scan) / len(some), some.take(measured)
    reason = why_no_intensity(some.points, some.intensity)
    bright = 0.0 if reason else upper_intensity(some.intensity)
    return ScanTraits.of(some.points, bright, per_point)


def groups_of(traits: Sequence[ScanTraits]) -> list[int]:
    """Return the group of each scan, the same for the scans of one sensor; 0 is the largest.

    Two sensors differ if a gap of one of `FACTORS` divides their scans when all are sorted by that
    trait. A scan that is cut off or thinned out has the same shares of its points around the
    elevations, and is of the same sensor if it has more than one in `POINTS_FACTOR`. Unknown
    intensities, 0, divide nothing. Of groups of equal size, that of the first scan comes first.
    """
    group_of = np.zeros(len(traits), np.intp)
    usual: list[Double] = []
    for members in _divided(np.array([each.compared for each in traits])):
        own = np.median(_values([traits[i].compared for i in members]), axis=0)
        alike = (i for i, each in enumerate(usual) if (_steps(each, own)[SHARES - 2 :] < 1).all())
        group_of[members] = next(alike, len(usual))
        usual.append(own)
    ranks = [group for group, _ in Counter(group_of.tolist()).most_common()]
    return [ranks.index(group) for group in group_of.tolist()]


def _divided(compared: Double) -> list[Indices]:
    """Return the indices of scans that no gap divides, by what is compared of scans (F, T)."""
    if not len(compared):
        return []
    columns = zip(_values(compared).T, FACTORS[:SHARES], strict=False)
    keys = np.stack([_between_gaps(values, factor) for values, factor in columns], axis=1)
    groups = [np.flatnonzero((keys == key).all(axis=1)) for key in dict.fromkeys(map(tuple, keys))]
    if len(groups) == 1:
        return groups
    # Without the larger scans of other sensors, smaller counts matter.
    return [group[part] for group in groups for part in _divided(compared[group])]


def usual_traits(traits: Sequence[ScanTraits]) -> tuple[float, ...]:
    """Return the medians of what is compared of scans."""
    return tuple(np.median([each.compared for each in traits], axis=0).round(DIGITS).tolist())


def sensor_of(scan: Scan, sensor: Sensor) -> Sensor:
    """Return which of the sensors that were fitted to scans of several a scan is of."""
    if not sensor.others:
        return sensor
    fits, own = sensor.members, traits_of(scan)
    if own is None:
        return fits[0]
    values = _values([own.compared, *(each.traits for each in fits)])
    return fits[int(_steps(values[1:], values[0]).sum(axis=1).argmin())]


def _values(compared: Sequence[Sequence[float]] | Double) -> Double:
    """Return the traits (F, T) float64 of scans, as `FACTORS`, by those that were `compared`."""
    values, counts = np.array(compared, np.float64), len(NODES_DEG) - 1
    points = values[:, counts : counts + 1]
    shares = np.maximum(values[:, :counts] / points, MIN_SHARE)
    values[:, :counts] = np.maximum(values[:, :counts], MIN_SHARE * points.max())
    return np.concatenate([values, shares], axis=1)


def _steps(values: Double, others: Double) -> Double:
    """Return how many of `FACTORS` lie between traits (…, T), 0 where one is unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.abs(np.log(values / others)) / np.log(FACTORS)
    return np.where((values > 0) & (others > 0), steps, 0)


def _between_gaps(values: Double, factor: float) -> Indices:
    """Return the groups (F,), from 0, of values that gaps of a factor divide; 0 is unknown."""
    groups = np.zeros(len(values), np.intp)
    known = np.flatnonzero(values > 0)
    order = known[np.argsort(values[known], kind="stable")]
    gaps = values[order][1:] > factor * values[order][:-1]
    groups[order[1:]] = np.cumsum(gaps)
    return groups
