# SPDX-License-Identifier: MIT
"""Intensity of a scan: its quantiles, its match to that of training, and values that are none.

Intensities are mapped to the scale of training, quantile by quantile.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.geometry.point_sample import measured_ranges, sample_places
from salsanext_cli.core.records import MAX_INTENSITY, Double, Float, Indices, Mask
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS, Sensor
from salsanext_cli.core.texts import percentage

QUANTILE_DIGITS = 6  # Significant digits of a quantile
BRIGHT = 0.95  # Share of the points that are darker than the upper intensity
BRIGHT_LEVEL = round(BRIGHT * (INTENSITY_LEVELS - 1))  # Index of its quantile
INTENSITY_FACTOR = 4.0  # Largest factor between the upper intensities of scans of one scale
NO_INTENSITY = (0.0,) * INTENSITY_LEVELS
"""Quantiles of a sensor without intensity; they map every value to the mean."""
MIN_PIXELS = 1000  # Fewest pixels of a scan whose quantiles count, unless all scans have fewer
SAMPLE = 1024  # Points of a scan that are checked, so few that they are not neighbours
MIN_INTENSITY_POINTS = 100  # Fewest points with an intensity for a check of its dependence
MAX_UNUSABLE = 0.05  # Largest share of points without a usable intensity; real scans had none
MAX_EQUAL = 0.95  # Largest share of points of the same intensity; real scans had 0.16 or less
MAX_DEPENDENCE = 0.9
"""Largest `dependence` of an intensity on range, direction, order; real ones had 0.88 or less."""


def match_intensity(channels: Float, source: Sequence[float], target: Sequence[float]) -> Float:
    """Return a range image with the quantiles of its intensity mapped to others.

    A value of several quantiles becomes the mean of their targets. An image without intensity has
    the source `NO_INTENSITY`, which maps everything to the mean.

    Parameters
    ----------
    channels : (5, H, W) float32
        Range image.
    source : sequence of float
        Quantiles of the intensity of the sensor.
    target : sequence of float
        Quantiles of the intensity of training, at the same levels.

    Returns
    -------
    (5, H, W) float32
        Range image; empty pixels stay 0.
    """
    occupied = np.flatnonzero(channels[0] > 0)
    sampled = occupied[sample_places(len(occupied), SAMPLE)]
    points, intensity = _pixels(channels, sampled)
    matched_quantiles = quantiles_to_match(points, intensity, source, target)
    if matched_quantiles is None:
        return channels
    matched = channels.copy()
    matched[4] = on_other_scale(channels[4], matched_quantiles, target)
    matched[4][channels[0] <= 0] = 0
    return matched


def on_other_scale(intensity: Float, source: Sequence[float], target: Sequence[float]) -> Float:
    """Return intensities with their quantiles mapped to others, as `match_intensity` does.

    Parameters
    ----------
    intensity : float32 array
        Intensities, of any shape.
    source : sequence of float
        Quantiles of the sensor.
    target : sequence of float
        Quantiles of training, at the same levels.

    Returns
    -------
    float32 array
        Of the same shape.
    """
    values, targets = scale_table(source, target)
    return np.interp(intensity, values, targets).astype(np.float32)


def scale_table(source: Sequence[float], target: Sequence[float]) -> tuple[Double, Double]:
    """Return the different quantiles of a sensor, rising, and the mean of their targets.

    Parameters
    ----------
    source : sequence of float
        Quantiles of the sensor.
    target : sequence of float
        Quantiles of training, at the same levels.

    Returns
    -------
    values : (K,) float64
        Quantiles of the sensor.
    targets : (K,) float64
        Intensities of training; those between are interpolated.
    """
    values, place = np.unique(np.asarray(source), return_inverse=True)
    return values, np.bincount(place, target) / np.bincount(place)


def quantiles_to_match(
    points: Float, intensity: Float, source: Sequence[float], target: Sequence[float]
) -> Sequence[float] | None:
    """Return the quantiles of an image that are mapped to those of training.

    Parameters
    ----------
    points : (M, 3) float32
        Coordinates of a sample of its pixels in metres.
    intensity : (M,) float32
        Their values.
    source : sequence of float
        Quantiles of the sensor.
    target : sequence of float
        Quantiles of training, at the same levels.

    Returns
    -------
    sequence of float or None
        `NO_INTENSITY` if the values are no intensities; None if they are on the scale of training.
    """
    if _why_sample_has_none(points, intensity):
        return NO_INTENSITY
    return None if source == target else source


def intensity_quantiles(images: Iterable[Float]) -> tuple[float, ...]:
    """Return the mean over range images of the quantiles of their intensity.

    Images of another scale than most, without intensity or with fewer than `MIN_PIXELS` pixels are
    skipped if there are others.

    Parameters
    ----------
    images : iterable of (5, H, W) float32
        Range images.

    Returns
    -------
    tuple of float
        Quantiles at `INTENSITY_LEVELS` levels; `NO_INTENSITY` if no image has an intensity; empty
        if no image has a pixel with a point.
    """
    intensities = []
    has_pixels = False
    for channels in images:
        points, values = _pixels(channels, np.flatnonzero(channels[0] > 0))
        has_pixels = has_pixels or len(values) > 0
        if len(values) and not why_no_intensity(points, values):
            intensities.append(values)
    if not has_pixels:
        return ()
    if not intensities:
        return NO_INTENSITY
    enough = [values for values in intensities if len(values) >= MIN_PIXELS] or intensities
    levels = np.linspace(0, 1, INTENSITY_LEVELS)
    quantiles = np.array([np.quantile(values, levels) for values in enough])
    compared = quantiles[_has_usual_scale(quantiles[:, BRIGHT_LEVEL])]
    return tuple(float(f"{value:.{QUANTILE_DIGITS}g}") for value in compared.mean(axis=0))


def _has_usual_scale(upper: npt.NDArray[np.floating]) -> Mask:
    """Return which upper intensities (N,) are near their median: (N,)."""
    median = np.sort(upper)[len(upper) // 2]
    if median <= 0:  # Factors have no meaning for decibels.
        return np.ones(len(upper), bool)
    return (upper * INTENSITY_FACTOR >= median) & (upper <= median * INTENSITY_FACTOR)


def bright_intensity(sensor: Sensor) -> float:
    """Return the intensity of bright surfaces; 1 if the quantiles of a sensor do not show it."""
    quantiles = sensor.intensity_quantiles
    if not quantiles or quantiles[BRIGHT_LEVEL] <= 0:
        return 1.0
    return quantiles[BRIGHT_LEVEL]


def why_no_intensity(points: Float, intensity: Float) -> str:
    """Return why values of points are not intensities.

    Parameters
    ----------
    points : (N, 3) float32
        Coordinates in metres.
    intensity : (N,) float32
        Values of the points.

    Returns
    -------
    str
        Reason in words; empty if they are intensities.
    """
    sampled = sample_places(len(points), SAMPLE)
    return _why_sample_has_none(points[sampled], intensity[sampled])


def _why_sample_has_none(points: Float, intensity: Float) -> str:
    """Return why the values (M,) of a sample of points (M, 3) are not intensities; else empty."""
    ranges, measured = measured_ranges(points)
    if not measured.any():
        return ""
    usable = measured & (np.abs(intensity) <= MAX_INTENSITY)
    unusable = 1 - usable.sum() / measured.sum()
    if unusable > MAX_UNUSABLE:
        limit = f"NaN or above {MAX_INTENSITY:g}"
        return f"{percentage(unusable, 0)} of the points have no intensity: {limit}"
    values = intensity[usable]
    equal = np.unique(values, return_counts=True)[1].max() / len(values)
    if equal > MAX_EQUAL:
        return f"no intensity: {percentage(equal, 0)} of the points have the same value"
    if len(values) < MIN_INTENSITY_POINTS:
        return ""
    return _why_dependent(points[usable], ranges[usable], values)


def _why_dependent(points: Float, ranges: Double, values: Float) -> str:
    """Return which property of points (M, 3) their values (M,) follow, in words; else empty."""
    x, y, z = points.T
    properties = {
        "range": ranges,
        "elevation": z / ranges,
        "azimuth": np.arctan2(y, x),
        "order": np.arange(len(values)),
    }
    ranks = _ranks(values)
    dependences = {name: dependence(ranks, other) for name, other in properties.items()}
    most = max(dependences, key=lambda name: dependences[name])
    if dependences[most] > MAX_DEPENDENCE:
        return f"no intensity: its values follow the {most} of the points"
    return ""


def dependence(ranks: npt.NDArray[np.int64], on: npt.NDArray[np.number]) -> float:
    """Return Chatterjee's coefficient (arXiv 1909.10140) of values on others.

    It is ``1 - N Σ |r(i+1) - r(i)| / (2 Σ l(i) (N - l(i)))``, in the order of the others, where r
    and l are the ranks.

    Parameters
    ----------
    ranks : (2, N) int64
        Numbers of values that are at most, and at least, each value; the values are not all equal.
    on : (N,) array
        Other values.

    Returns
    -------
    float
        About 0 for independent values, and 1 for any function of the others.
    """
    rank, rank_from_above = ranks
    count = len(on)
    steps = np.abs(np.diff(rank[np.argsort(on, kind="stable")])).sum()
    return float(1 - count * steps / (2 * (rank_from_above * (count - rank_from_above)).sum()))


def _pixels(channels: Float, pixels: Indices) -> tuple[Float, Float]:
    """Return points (M, 3) and intensities (M,) of the pixels with flat indices (M,)."""
    flat = channels.reshape(len(channels), -1)
    return flat[1:4, pixels].T, flat[4, pixels]


def _ranks(values: Float) -> npt.NDArray[np.int64]:
    """Return the numbers of values (N,) that are at most, and at least, each value: (2, N)."""
    ordered = np.sort(values)
    count = len(values)
    below = np.searchsorted(ordered, values, "left")
    return np.stack([np.searchsorted(ordered, values, "right"), count - below])
