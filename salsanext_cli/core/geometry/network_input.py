# SPDX-License-Identifier: MIT
"""Input of a network from a range image: intensity and row gaps as in training, normalised.

Intensities are mapped to the scale of training, quantile by quantile. The gaps that sparser beams
leave between rows are filled.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import UsageError, percentage
from salsanext_cli.core.geometry.projection import measured_ranges, sample_places
from salsanext_cli.core.records import MAX_INTENSITY, Float
from salsanext_cli.core.sensors.sensor import INTENSITY_LEVELS, Sensor
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
    """Return channels (5, H, W) as input, (1, 5, H, W) float32, of weights of another sensor."""
    source, target = sensor.intensity_quantiles, trained.intensity_quantiles
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
    """Return a range image (5, H, W) with the quantiles of its intensity mapped to others.

    A value of several quantiles becomes the mean of their targets. So `NO_INTENSITY`, the source of
    an image without intensity, maps everything to the mean. Empty pixels stay 0.
    """
    occupied = np.flatnonzero(channels[0] > 0)
    if why_no_intensity(*_pixels(channels, occupied[sample_places(len(occupied), SAMPLE)])):
        source = NO_INTENSITY
    elif source == target:
        return channels
    matched = channels.copy()
    matched[4] = on_other_scale(channels[4], source, target)
    matched[4][channels[0] <= 0] = 0
    return matched


def on_other_scale(intensity: Float, source: Sequence[float], target: Sequence[float]) -> Float:
    """Return intensities of any shape as float32, mapped as by `match_intensity`."""
    values, place = np.unique(np.asarray(source), return_inverse=True)
    wanted = np.bincount(place, target) / np.bincount(place)
    return np.interp(intensity, values, wanted).astype(np.float32)


def intensity_quantiles(images: Iterable[Float]) -> tuple[float, ...]:
    """Return the mean over range images of the `INTENSITY_LEVELS` quantiles of their intensity.

    Images of another scale than most, without intensity or with fewer than `MIN_PIXELS` pixels are
    skipped if there are others. Without intensity, the result is `NO_INTENSITY`; without pixels, it
    is empty.
    """
    seen = [_pixels(channels, np.flatnonzero(channels[0] > 0)) for channels in images]
    if not any(len(values) for _, values in seen):
        return ()
    known = [v for points, v in seen if len(v) and not why_no_intensity(points, v)]
    if not known:
        return NO_INTENSITY
    enough = [values for values in known if len(values) >= MIN_PIXELS] or known
    levels = np.linspace(0, 1, INTENSITY_LEVELS)
    quantiles = np.array([np.quantile(values, levels) for values in enough])
    upper = quantiles[:, round(BRIGHT * (INTENSITY_LEVELS - 1))]
    usual = np.sort(upper)[len(upper) // 2]
    if usual > 0:  # Factors have no meaning for decibels.
        is_usual = (upper * INTENSITY_FACTOR >= usual) & (upper <= usual * INTENSITY_FACTOR)
        quantiles = quantiles[is_usual]
    return tuple(float(f"{value:.{QUANTILE_DIGITS}g}") for value in quantiles.mean(axis=0))


def _pixels(channels: Float, chosen: npt.NDArray[np.int64]) -> tuple[Float, Float]:
    """Return points (M, 3) and intensities (M,) of the pixels with flat indices (M,)."""
    flat = channels.reshape(len(channels), -1)
    return flat[1:4, chosen].T, flat[4, chosen]


def bright_intensity(sensor: Sensor) -> float:
    """Return the intensity of bright surfaces, 1 if the quantiles of a sensor do not show it."""
    quantiles = sensor.intensity_quantiles
    bright = quantiles[round(BRIGHT * (INTENSITY_LEVELS - 1))] if quantiles else 1.0
    return bright if bright > 0 else 1.0


def why_no_intensity(points: Float, intensity: Float) -> str:
    """Return why values (N,) of points (N, 3) are not intensities; an empty text if they are."""
    places = sample_places(len(points), SAMPLE)
    points, intensity = points[places], intensity[places]
    ranges, measured = measured_ranges(points)
    usable = measured & (np.abs(intensity) <= MAX_INTENSITY)
    if not measured.any():
        return ""
    unusable = 1 - usable.sum() / measured.sum()
    if unusable > MAX_UNUSABLE:
        limit = f"NaN or above {MAX_INTENSITY:g}"
        return f"{percentage(unusable, 0)} of the points have no intensity: {limit}"
    values, ranges = intensity[usable], ranges[usable]
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
    ordered, count = np.sort(values), len(values)
    below = np.searchsorted(ordered, values, "left")
    return np.stack([np.searchsorted(ordered, values, "right"), count - below])


def dependence(ranks: npt.NDArray[np.int64], on: npt.NDArray[np.number]) -> float:
    """Return Chatterjee's coefficient (arXiv 1909.10140) of values on others (N,).

    It is about 0 for independent values and 1 for any function of the others:
    ``1 - N Σ |r(i+1) - r(i)| / (2 Σ l(i) (N - l(i)))``, in the order of the others. r and l are the
    `_ranks` of the values, which must not be all equal.
    """
    (up_to, from_on), count = ranks, len(on)
    steps = np.abs(np.diff(up_to[np.argsort(on, kind="stable")])).sum()
    return float(1 - count * steps / (2 * (from_on * (count - from_on)).sum()))


def row_gaps(images: Iterable[Float]) -> float | None:
    """Return the share of gaps, up to `MAX_GAP` empty pixels of a column; None without pixels."""
    gaps = occupied = 0
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
    gaps, usual = sensor.row_gaps, trained.row_gaps
    return gaps is not None and usual is not None and gaps > usual + MORE_GAPS


def with_filled_gaps(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return channels (5, H, W), with their gaps filled if `fills_rows` of the sensors."""
    return fill_rows(channels) if fills_rows(sensor, trained) else channels


def fill_rows(channels: Float) -> Float:
    """Return channels (5, H, W) in which empty pixels hold the next point below."""
    filled = channels.copy()
    for rows in range(1, FILLED_ROWS + 1):
        here, below = filled[:, :-rows], channels[:, rows:]
        np.copyto(here, below, where=here[0] <= 0)
    return filled
