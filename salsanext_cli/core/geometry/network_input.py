# SPDX-License-Identifier: MIT
"""Input of a network from a range image: intensity and row gaps as in training, normalised.

Intensities are mapped to the scale of training, quantile by quantile. The gaps that sparser beams
leave between rows are filled.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.geometry.point_sample import measured_ranges, sample_places
from salsanext_cli.core.records import MAX_INTENSITY, Float
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS, Sensor
from salsanext_cli.core.texts import percentage
from salsanext_cli.core.wording import argument

QUANTILE_DIGITS = 6  # Significant digits of a quantile
BRIGHT = 0.95  # Quantile of the upper intensity, which shows the scale
INTENSITY_FACTOR = 4.0  # Largest factor between the upper intensities of scans of one scale
NO_INTENSITY = (0.0,) * INTENSITY_LEVELS  # Quantiles that map every intensity to the mean
MIN_PIXELS = 1000  # Fewest pixels of a scan whose quantiles count, unless all scans have fewer
SAMPLE = 1024  # Points of a scan that are checked, so few that they are not neighbours
MIN_INTENSITY_POINTS = 100  # Fewest points with an intensity for a check of its dependence
MAX_UNUSABLE = 0.05  # Largest share of points without a usable intensity; real scans had none
MAX_EQUAL = 0.95  # Largest share of points of the same intensity; real scans had 0.16 or less
MAX_DEPENDENCE = 0.9
"""Largest `dependence` of an intensity on range, direction, order; real ones had 0.88 or less."""
MAX_GAP = 6  # Most rows of a gap; larger ones are sky or missing returns
FILLED_ROWS = 2  # Rows within which a gap is filled: one more or less is worse on most scans
MORE_GAPS = 0.08  # Excess of gaps over training above which filling improves labels
GAP_DIGITS = 4


def network_input(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return the input of weights from channels of another sensor.

    Parameters
    ----------
    channels : (5, H, W) float32
        Range image: range, x, y, z in metres, intensity.
    sensor : Sensor
        Sensor of the image, fitted to its scans.
    trained : Sensor
        Sensor of the weights.

    Returns
    -------
    (1, 5, H, W) float32
        Normalised channels.
    """
    source = sensor.intensity_quantiles
    target = trained.intensity_quantiles
    if source and target:
        channels = match_intensity(channels, source, target)
    return normalise(with_filled_gaps(channels, sensor, trained), sensor)[None]


def normalise(channels: Float, sensor: Sensor) -> Float:
    """Return ``(channel − mean) / std``, (5, H, W) float32; 0 in empty pixels."""
    means = np.asarray(sensor.means, np.float32).reshape(-1, 1, 1)
    stds = np.asarray(sensor.stds, np.float32).reshape(-1, 1, 1)
    normal = channels - means
    normal /= stds
    normal[:, channels[0] <= 0] = 0
    return normal


def noise_of(sensor: Sensor) -> tuple[float, float]:
    """Return the standard deviations of ranges, in metres, and of intensities."""
    if sensor.range_noise is None or sensor.intensity_noise is None:
        expected = "range_noise in metres and intensity_noise"
        hint = f"write both into a sensor file and pass it with {argument('sensor')}"
        raise UsageError(f"sensor {sensor.name}", "states no noise", expected, hint)
    return sensor.range_noise, sensor.intensity_noise


def match_intensity(channels: Float, source: Sequence[float], target: Sequence[float]) -> Float:
    """Return a range image with the quantiles of its intensity mapped to others.

    A value of several quantiles becomes the mean of their targets. So `NO_INTENSITY`, the source of
    an image without intensity, maps everything to the mean.

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
    points, intensity = _pixels(channels, occupied[sample_places(len(occupied), SAMPLE)])
    if why_no_intensity(points, intensity):
        source = NO_INTENSITY
    elif source == target:
        return channels
    matched = channels.copy()
    matched[4] = on_other_scale(channels[4], source, target)
    matched[4][channels[0] <= 0] = 0
    return matched


def on_other_scale(intensity: Float, source: Sequence[float], target: Sequence[float]) -> Float:
    """Map intensities as by `match_intensity`.

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
    values, place = np.unique(np.asarray(source), return_inverse=True)
    targets = np.bincount(place, target) / np.bincount(place)
    return np.interp(intensity, values, targets).astype(np.float32)


def intensity_quantiles(images: Iterable[Float]) -> tuple[float, ...]:
    """Return the mean over range images of the `INTENSITY_LEVELS` quantiles of their intensity.

    Images of another scale than most, without intensity or with fewer than `MIN_PIXELS` pixels are
    skipped if there are others. Without intensity, the result is `NO_INTENSITY`; without pixels, it
    is empty.
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
    upper = quantiles[:, round(BRIGHT * (INTENSITY_LEVELS - 1))]
    median = np.sort(upper)[len(upper) // 2]
    if median > 0:  # Factors have no meaning for decibels.
        is_of_scale = (upper * INTENSITY_FACTOR >= median) & (upper <= median * INTENSITY_FACTOR)
        quantiles = quantiles[is_of_scale]
    return tuple(float(f"{value:.{QUANTILE_DIGITS}g}") for value in quantiles.mean(axis=0))


def _pixels(channels: Float, pixels: npt.NDArray[np.int64]) -> tuple[Float, Float]:
    """Return points (M, 3) and intensities (M,) of the pixels with flat indices (M,)."""
    flat = channels.reshape(len(channels), -1)
    return flat[1:4, pixels].T, flat[4, pixels]


def bright_intensity(sensor: Sensor) -> float:
    """Return the intensity of bright surfaces, 1 if the quantiles of a sensor do not show it."""
    quantiles = sensor.intensity_quantiles
    bright = quantiles[round(BRIGHT * (INTENSITY_LEVELS - 1))] if quantiles else 1.0
    return bright if bright > 0 else 1.0


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
    places = sample_places(len(points), SAMPLE)
    points = points[places]
    intensity = intensity[places]
    ranges, measured = measured_ranges(points)
    usable = measured & (np.abs(intensity) <= MAX_INTENSITY)
    if not measured.any():
        return ""
    unusable = 1 - usable.sum() / measured.sum()
    if unusable > MAX_UNUSABLE:
        limit = f"NaN or above {MAX_INTENSITY:g}"
        return f"{percentage(unusable, 0)} of the points have no intensity: {limit}"
    values = intensity[usable]
    ranges = ranges[usable]
    equal = np.unique(values, return_counts=True)[1].max() / len(values)
    if equal > MAX_EQUAL:
        return f"no intensity: {percentage(equal, 0)} of the points have the same value"
    if len(values) < MIN_INTENSITY_POINTS:
        return ""
    x, y, z = points[usable].T
    others = {
        "range": ranges,
        "elevation": z / ranges,
        "azimuth": np.arctan2(y, x),
        "order": np.arange(len(values)),
    }
    ranks = _ranks(values)
    dependences = {name: dependence(ranks, other) for name, other in others.items()}
    most = max(dependences, key=lambda name: dependences[name])
    if dependences[most] > MAX_DEPENDENCE:
        return f"no intensity: its values follow the {most} of the points"
    return ""


def _ranks(values: Float) -> npt.NDArray[np.int64]:
    """Return the numbers of values (N,) that are at most, and at least, each value: (2, N)."""
    ordered = np.sort(values)
    count = len(values)
    below = np.searchsorted(ordered, values, "left")
    return np.stack([np.searchsorted(ordered, values, "right"), count - below])


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


def row_gaps(images: Iterable[Float]) -> float | None:
    """Return the share of gaps, up to `MAX_GAP` empty pixels of a column; None without pixels."""
    gaps = 0
    occupied = 0
    for channels in images:
        full = channels[0] > 0
        row = np.arange(len(full))[:, None]
        above = np.maximum.accumulate(np.where(full, row, -len(full) - MAX_GAP), axis=0)
        below = np.minimum.accumulate(np.where(full, row, 2 * len(full))[::-1], axis=0)[::-1]
        gaps += int((~full & (below - above <= MAX_GAP + 1)).sum())
        occupied += int(full.sum())
    return round(gaps / (gaps + occupied), GAP_DIGITS) if occupied else None


def with_image_statistics(sensor: Sensor, images: Sequence[Float]) -> Sensor:
    """Return the sensor with the intensity and the gaps of its range images, (5, H, W) each."""
    quantiles = intensity_quantiles(images)
    return replace(sensor, intensity_quantiles=quantiles, row_gaps=row_gaps(images))


def column_gaps(images: Iterable[Float]) -> float | None:
    """Return the share of gaps, up to `MAX_GAP` empty pixels of a row; None without pixels."""
    return row_gaps(channels.transpose(0, 2, 1) for channels in images)


def fills_rows(sensor: Sensor, trained: Sensor) -> bool:
    """Return whether a sensor has many more gaps than training, so that they are filled."""
    if sensor.row_gaps is None or trained.row_gaps is None:
        return False
    return sensor.row_gaps > trained.row_gaps + MORE_GAPS


def with_filled_gaps(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return channels with their gaps filled, if the sensor has many more than training.

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
    (5, H, W) float32
    """
    return fill_rows(channels) if fills_rows(sensor, trained) else channels


def fill_rows(channels: Float) -> Float:
    """Return channels (5, H, W) in which empty pixels hold the next point below."""
    filled = channels.copy()
    for rows in range(1, FILLED_ROWS + 1):
        upper = filled[:, :-rows]
        lower = channels[:, rows:]
        np.copyto(upper, lower, where=upper[0] <= 0)
    return filled
