# SPDX-License-Identifier: MIT
"""Traits of a scan that depend on its sensor and hardly on the location."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.geometry.intensity import BRIGHT, why_no_intensity
from salsanext_cli.core.geometry.point_sample import few_points, measured_ranges
from salsanext_cli.core.records import MAX_INTENSITY, Double, Float, Indices, Scan
from salsanext_cli.core.sensors.sensor import Sensor

NODES_DEG = (-30.0, -20.0, -12.0, -6.0, -3.0)
"""Elevations between which points are counted: below the sky, beams meet the ground everywhere."""
NODES = len(NODES_DEG) - 1  # Number of elevations around which points are counted
MIN_TRAIT_POINTS = 100  # Fewest points with a measurement that show traits
MIN_SHARE = 0.02  # Smallest share of points around an elevation that counts
DENSITY_FACTOR = 1.5
"""Least factor between sensors; scans of one had up to 1.27, the most similar sensors 1.77."""
POINTS_FACTOR = 4.0  # The same for all points, whose number depends on the sky
BRIGHT_FACTOR = 8.0  # The same for intensities: one sensor had up to 5.7 (wet), scales 100 or more
SHARES_FACTOR = 1.35
"""The same for shares of points, which stay in cut or thinned scans; sensors had 1.4 or more."""
FACTORS = [DENSITY_FACTOR] * NODES + [POINTS_FACTOR, BRIGHT_FACTOR] + [SHARES_FACTOR] * NODES
"""Factors of the columns of `scaled_traits`."""
POINTS_COLUMN = NODES  # Column of the number of points, behind the points around the nodes
NUMBERS = slice(NODES + 2)  # The columns before
DIGITS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanTraits:
    """Traits of the sensor in one scan, estimated from a sample of its points.

    A point between two nodes counts for both by its distance, so that a beam near a node makes no
    difference.
    """

    below: tuple[float, ...]  # Number of points around each of `NODES_DEG` but the last
    points: int  # Number of points with a measurement
    bright: float  # Upper intensity; 0 if unknown
    sensor: Sensor | None = None  # Sensor that was fitted to the scan

    @classmethod
    def from_sines(
        cls, sines: Float, bright: float, per_point: float, sensor: Sensor | None = None
    ) -> ScanTraits:
        """Return the traits of a sample of points.

        Parameters
        ----------
        sines : (M,) float32
            Sines of elevation of the measured points of the sample.
        bright : float
            Upper intensity; 0 if unknown.
        per_point : float
            Number of points of the scan that each of them stands for.
        sensor : Sensor, optional
            Sensor that was fitted to the scan.

        Returns
        -------
        ScanTraits
        """
        elevations = np.degrees(np.arcsin(sines))
        hats = np.eye(len(NODES_DEG))[:-1]
        below = [np.interp(elevations, NODES_DEG, hat).sum() * per_point for hat in hats]
        counts = tuple(round(float(count), 1) for count in below)
        return cls(
            below=counts,
            points=round(len(sines) * per_point),
            bright=round(bright, DIGITS),
            sensor=sensor,
        )

    @property
    def compared(self) -> tuple[float, ...]:
        """Numbers (T,) that differ between sensors."""
        return (*self.below, float(self.points), self.bright)

    def __str__(self) -> str:
        """Describe the scan: ``92,677 points, intensities to 158``."""
        points = f"{self.points:,} points"
        return f"{points}, intensities to {self.bright:.3g}" if self.bright else points


def sines_of(points: Float) -> Float:
    """Return the sines of elevation of points (N, 3), (N,)."""
    ranges = np.sqrt(np.einsum("nk,nk->n", points, points))
    return (points[:, 2] / np.maximum(ranges, np.finfo(np.float32).tiny)).clip(-1, 1)


def intensity_of(points: Float, intensity: Float) -> tuple[str, float]:
    """Return the upper intensity of points, or why their values are not intensities.

    Parameters
    ----------
    points : (N, 3) float32
        Coordinates in metres.
    intensity : (N,) float32
        Values of the points.

    Returns
    -------
    reason : str
        Why they are not intensities; empty if they are.
    bright : float
        Upper intensity; 0 without any.
    """
    finite = intensity[np.isfinite(intensity)]
    reason = why_no_intensity(points, intensity)
    if reason or not len(finite):
        return reason, 0.0
    return "", float(np.quantile(finite, BRIGHT))


def traits_of(scan: Scan) -> ScanTraits | None:
    """Return the traits of a scan in the frame of its file, None for too few measured points."""
    sample = few_points(scan)
    per_point = len(scan) / max(len(sample), 1)
    measured = np.flatnonzero(measured_ranges(sample.points)[1])
    if len(measured) < MIN_TRAIT_POINTS:
        return None
    sample = sample.take(measured)
    _, bright = intensity_of(sample.points, sample.intensity)
    return ScanTraits.from_sines(sines_of(sample.points), bright, per_point)


def groups_of(traits: Sequence[ScanTraits]) -> list[int]:
    """Return the number of the group of each scan, by sensor.

    Two groups differ if a gap of one of `FACTORS` divides the scans sorted by that trait. Cut or
    thinned scans, with the same shares of points, belong to one group.

    Parameters
    ----------
    traits : sequence of ScanTraits
        Traits of the scans.

    Returns
    -------
    list of int
        Numbers from 0, the largest group.
    """
    group_of_scan = np.zeros(len(traits), np.intp)
    groups: list[int] = []  # Of each division, the first one that is like it
    medians: list[tuple[float, ...]] = []
    for number, members in enumerate(_divided(np.array([scan.compared for scan in traits]))):
        median = median_traits([traits[i] for i in members])
        alike = (groups[i] for i, other in enumerate(medians) if _are_alike(other, median))
        groups.append(next(alike, number))
        medians.append(median)
        group_of_scan[members] = groups[-1]
    ranks = [group for group, _ in Counter(group_of_scan.tolist()).most_common()]
    return [ranks.index(group) for group in group_of_scan.tolist()]


def _are_alike(first: Sequence[float], second: Sequence[float]) -> bool:
    """Return whether traits (T,) differ only as those of cut or thinned scans do."""
    first_scaled, second_scaled = scaled_traits([first, second])
    steps = np.abs(second_scaled - first_scaled)
    return bool((steps[POINTS_COLUMN:] < 1).all())


def _divided(compared: Double) -> list[Indices]:
    """Return the indices of the scans of each group without a gap, by their traits (F, T)."""
    if not len(compared):
        return []
    values = scaled_traits(compared)[:, NUMBERS]
    order = values.argsort(axis=0, kind="stable")
    gaps = np.diff(np.take_along_axis(values, order, axis=0), axis=0) > 1
    keys = np.zeros(values.shape, np.intp)
    np.put_along_axis(keys, order[1:], gaps.cumsum(axis=0), axis=0)
    kinds = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    groups: list[Indices] = [np.flatnonzero(kinds == kind) for kind in range(kinds.max() + 1)]
    if len(groups) == 1:
        return groups
    # Smaller counts matter without the larger scans of other sensors.
    return [group[places] for group in groups for places in _divided(compared[group])]


def scaled_traits(compared: npt.ArrayLike) -> Double:
    """Return traits of scans on scales where a step of 1 is one of `FACTORS`.

    Parameters
    ----------
    compared : (F, T) numbers
        Traits of each scan, as in `ScanTraits.compared`.

    Returns
    -------
    (F, T + NODES) float64
        The traits, and behind them the shares of the points around the nodes.
    """
    below, points, bright = np.split(np.array(compared, np.float64), (NODES, NODES + 1), axis=1)
    shares = np.maximum(below / points, MIN_SHARE)
    below = np.maximum(below, MIN_SHARE * points.max())
    # An unknown intensity divides no group.
    bright[bright <= 0] = bright.min(where=bright > 0, initial=MAX_INTENSITY)
    scaled: Double = np.log(np.hstack([below, points, bright, shares])) / np.log(FACTORS)
    return scaled


def median_traits(traits: Sequence[ScanTraits]) -> tuple[float, ...]:
    """Return the medians (T,) of the traits of scans."""
    return tuple(np.median([scan.compared for scan in traits], axis=0).round(DIGITS).tolist())


def kinds_of(scans: Sequence[Scan]) -> tuple[list[int], list[tuple[float, ...]]]:
    """Return the groups of scans by sensor.

    Parameters
    ----------
    scans : sequence of Scan
        Scans in the frames of their files.

    Returns
    -------
    kinds : list of int
        Number of the group of each scan, as of `groups_of`; 0 for scans without traits.
    traits : list of tuple of float
        Usual traits of each group; empty if no scan shows any.
    """
    traits = {}
    for number, scan in enumerate(scans):
        scan_traits = traits_of(scan)
        if scan_traits:
            traits[number] = scan_traits
    kinds = np.zeros(len(scans), np.intp)
    kinds[list(traits)] = groups_of(list(traits.values()))
    count = kinds.max(initial=0) + 1
    groups = [[traits[i] for i in traits if kinds[i] == kind] for kind in range(count)]
    return kinds.tolist(), [median_traits(group) for group in groups if group]
