# SPDX-License-Identifier: MIT
"""Range image to the input of a network: intensity and row gaps as in training, normalised.

Intensities are mapped to the scale of the sensor of training, quantile by quantile, and the gaps
that sparser beams leave between rows are filled.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.projection import measured_ranges, sample_places
from salsanext_cli.records import MAX_INTENSITY, Float
from salsanext_cli.sensors.sensor import INTENSITY_LEVELS, Sensor

QUANTILE_DIGITS = 6  # Significant digits of a quantile
BRIGHT = 0.95  # Quantile of the upper intensities, which tell the scale
INTENSITY_FACTOR = 4.0  # Largest factor between the upper intensities of scans of one scale
NO_INTENSITY = (0.0,) * INTENSITY_LEVELS  # Quantiles that map scans without intensity to the mean
MIN_PIXELS = 1000  # Fewest pixels of a scan whose quantiles count, unless all scans have fewer
SAMPLE = 1024  # Points of a scan that are looked at, so few that they are no neighbours
MIN_INTENSITY_POINTS = 100  # Fewest points with an intensity of which something is said
MAX_UNUSABLE = 0.05  # Largest share of points without a usable intensity; real scans had none
MAX_EQUAL = 0.95  # Largest share of points of the same intensity; real scans had 0.16 or less
MAX_DEPENDENCE = 0.9
"""Largest `dependence` of an intensity on range, direction, order; real ones had 0.88 or less."""
MAX_GAP = 6  # Most rows of a gap; larger ones are sky, or beams that returned nothing
FILLED_ROWS = 2  # Rows within which a gap is filled: one more or less is worse on most scans
MORE_GAPS = 0.08  # Further gaps than in training above which filling makes labels better
GAP_DIGITS = 4


def network_input(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return channels (5, H, W) as weights of another sensor take them, (1, 5, H, W) float32."""
    own, of_training = sensor.intensity_quantiles, trained.intensity_quantiles
    if own and of_training:
        channels = match_intensity(channels, own, of_training)
    return normalise(with_filled_gaps(channels, sensor, trained), sensor)[None]


def normalise(channels: Float, sensor: Sensor) -> Float:
    """Return ``(channel − mean) / std``, (5, H, W) float32; 0 where the range is 0: empty."""
    means = np.asarray(sensor.means, np.float32).reshape(-1, 1, 1)
    stds = np.asarray(sensor.stds, np.float32).reshape(-1, 1, 1)
    normal = channels - means
    normal /= stds
    normal[:, channels[0] <= 0] = 0
    return normal


def noise_of(sensor: Sensor) -> tuple[float, float]:
    """Return the noise of ranges (metres) and of intensities, as standard deviations."""
    if sensor.range_noise is None or sensor.intensity_noise is None:
        found, expected = "its noise is not known", "range_noise in metres and intensity_noise"
        hint = "write both into a sensor's .toml and give it with --sensor"
        raise UsageError(f"sensor {sensor.name}", found, expected, hint)
    return sensor.range_noise, sensor.intensity_noise


def match_intensity(channels: Float, source: Sequence[float], target: Sequence[float]) -> Float:
    """Return a range image (5, H, W) with the quantiles of its intensity mapped to others."""
    # Linearly between; a value at which several quantiles lie becomes the mean of theirs, so that
    # `NO_INTENSITY` makes everything the mean of the target. That is what becomes of an image
    # without intensity, whatever the source. Empty pixels stay 0.
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
    """Return intensities of any shape with their quantiles mapped as `match_intensity` does."""
    values, place = np.unique(np.asarray(source), return_inverse=True)
    wanted = np.bincount(place, target) / np.bincount(place)
    return np.interp(intensity, values, wanted).astype(np.float32)


def intensity_quantiles(images: Iterable[Float]) -> tuple[float, ...]:
    """Return the quantiles of intensity, the mean of those of each range image."""
    # Images of another scale than most, without intensity, and of fewer than `MIN_PIXELS` pixels do
    # not count beside others, so that a few odd scans leave the result as it is. Returns
    # `INTENSITY_LEVELS` floats that rise, `NO_INTENSITY` if no image has an intensity, nothing if
    # none has a pixel.
    seen = [_pixels(channels, np.flatnonzero(channels[0] > 0)) for channels in images]
    if not any(len(values) for _, values in seen):
        return ()
    known = [v for points, v in seen if len(v) and not why_no_intensity(points, v)]
    if not known:
        return NO_INTENSITY
    enough = [values for values in known if len(values) >= MIN_PIXELS] or known
    levels = np.linspace(0, 1, INTENSITY_LEVELS)
    each = np.array([np.quantile(values, levels) for values in enough])
    upper = each[:, round(BRIGHT * (INTENSITY_LEVELS - 1))]
    usual = np.sort(upper)[len(upper) // 2]
    if usual > 0:  # Decibels have no factors.
        each = each[(upper * INTENSITY_FACTOR >= usual) & (upper <= usual * INTENSITY_FACTOR)]
    return tuple(float(f"{value:.{QUANTILE_DIGITS}g}") for value in each.mean(axis=0))


def _pixels(channels: Float, chosen: npt.NDArray[np.int64]) -> tuple[Float, Float]:
    """Return points (M, 3) and intensities (M,) of pixels, chosen by their flat index."""
    flat = channels.reshape(len(channels), -1)
    return flat[1:4, chosen].T, flat[4, chosen]


def bright_intensity(sensor: Sensor) -> float:
    """Return the intensity of bright surfaces, 1 where a sensor's quantiles do not tell it."""
    quantiles = sensor.intensity_quantiles
    bright = quantiles[round(BRIGHT * (INTENSITY_LEVELS - 1))] if quantiles else 1.0
    return bright if bright > 0 else 1.0


def why_no_intensity(points: Float, intensity: Float) -> str:
    """Say why intensities (N,) of points (N, 3) in the order of a file are none, or nothing."""
    places = sample_places(len(points), SAMPLE)
    points, intensity = points[places], intensity[places]
    ranges, measured = measured_ranges(points)
    usable = measured & (np.abs(intensity) <= MAX_INTENSITY)
    if not measured.any():
        return ""
    unusable = 1 - usable.sum() / measured.sum()
    if unusable > MAX_UNUSABLE:
        return f"{unusable:.0%} of the points have no intensity: NaN or above {MAX_INTENSITY:g}"
    values, ranges = intensity[usable], ranges[usable]
    equal = np.unique(values, return_counts=True)[1].max() / len(values)
    if equal > MAX_EQUAL:
        return f"no intensity: {equal:.0%} of the points have the same"
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
    """Return how many values (N,) are up to each, and how many from it on, (2, N)."""
    ordered, count = np.sort(values), len(values)
    below = np.searchsorted(ordered, values, "left")
    return np.stack([np.searchsorted(ordered, values, "right"), count - below])


def dependence(ranks: npt.NDArray[np.int64], on: npt.NDArray[np.number]) -> float:
    """Return how far values, not all equal, are a function of others (N,), of whatever form."""
    # Chatterjee's coefficient (arXiv 1909.10140), about 0 for independent values and 1 for a
    # function: 1 - N Σ |r(i+1) - r(i)| / (2 Σ l(i) (N - l(i))), the values ordered by the others; r
    # and l are the `_ranks`.
    (up_to, from_on), count = ranks, len(on)
    steps = np.abs(np.diff(up_to[np.argsort(on, kind="stable")])).sum()
    return float(1 - count * steps / (2 * (from_on * (count - from_on)).sum()))


def row_gaps(images: Iterable[Float]) -> float | None:
    """Return the share of gaps, up to `MAX_GAP` empty pixels between two of points in a column."""
    gaps = occupied = 0
    for channels in images:
        full = channels[0] > 0
        row = np.arange(len(full))[:, None]
        above = np.maximum.accumulate(np.where(full, row, -len(full) - MAX_GAP), axis=0)
        below = np.minimum.accumulate(np.where(full, row, 2 * len(full))[::-1], axis=0)[::-1]
        gaps += int((~full & (below - above <= MAX_GAP + 1)).sum())
        occupied += int(full.sum())
    return round(gaps / (gaps + occupied), GAP_DIGITS) if occupied else None


def fills_rows(sensor: Sensor, trained: Sensor) -> bool:
    """Say whether scans have so many more gaps than those of training that they are filled."""
    own, of_training = sensor.row_gaps, trained.row_gaps
    return own is not None and of_training is not None and own > of_training + MORE_GAPS


def with_filled_gaps(channels: Float, sensor: Sensor, trained: Sensor) -> Float:
    """Return channels (5, H, W) with their gaps filled where `fills_rows` says so."""
    return fill_rows(channels) if fills_rows(sensor, trained) else channels


def fill_rows(channels: Float) -> Float:
    """Return channels (5, H, W) whose empty pixels hold the next point below."""
    filled = channels.copy()
    for rows in range(1, FILLED_ROWS + 1):
        here, below = filled[:, :-rows], channels[:, rows:]
        np.copyto(here, below, where=here[0] <= 0)
    return filled
