# SPDX-License-Identifier: MIT
"""Changes of a scan or its range image as if another sensor, or one mounted otherwise, had made it.

Their sizes cover the 16 to 128 beams, the views and the places on a roof of sensors on the market,
and the intensities that are left after `match_intensity`, which knows neither a sensor's response
to distance nor which surfaces a street has.
"""

from dataclasses import replace

import numpy as np

from salsanext_cli.geometry.projection import measured_ranges
from salsanext_cli.records import Float, Scan
from salsanext_cli.sensors.sensor import Sensor
from salsanext_cli.training.data.augment import shift

Rng = np.random.Generator

LOG_GAIN, LOG_GAMMA, RANGE_POWER, OFFSET = 0.3, 0.3, 0.15, 0.05
"""Standard deviations of what intensities are changed by: log of gain and of exponent, power of the
range, and offset."""
RESPONSE_RANGE_M = 10.0
"""Range at which a power of the range changes nothing."""
LOWERED_M, RAISED_M = 0.55, 0.9
"""Largest distances that a sensor is moved down and up."""
TILT_DEG = 1.0
"""Standard deviation of the angle that a sensor is tilted by."""
EDGE_SHIFT_DEG, EDGE_SHIFT = 6.0, 0.25
"""Largest shift of an edge of the view, in degrees and as a share of the view, so that the edges
never meet."""
LEAST_ROWS, MOST_ROWS = 0.25, 0.75
"""Bounds of the share of rows that are kept."""


def change_intensity(scan: Scan, bright: float, random: Rng) -> Scan:
    """Return a scan whose intensities i become gain · i^gamma · (range / 10 m)^power + offset.

    They are in units of `bright`, that of bright surfaces, before and after.
    """
    gain, gamma = np.exp(random.normal(0, (LOG_GAIN, LOG_GAMMA)))
    power, offset = random.normal(0, (RANGE_POWER, OFFSET))
    ranges, measured = measured_ranges(scan.points)
    response = np.where(measured, ranges / RESPONSE_RANGE_M, 1.0) ** power
    positive = np.clip(scan.intensity, 0, None).astype(np.float64) / bright
    changed = bright * (gain * positive**gamma * response + offset)
    return replace(scan, intensity=changed.astype(np.float32))


def mount_otherwise(points: Float, random: Rng) -> Float:
    """Return points (N, 3) as from a sensor at another height and tilted in any direction."""
    angle, azimuth = np.radians(random.normal(0, TILT_DEG)), random.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0])
    # Rodrigues' rotation about a level axis; a degree or two, yet exact.
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) - np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    with np.errstate(invalid="ignore", over="ignore"):
        tilted: Float = points @ turn.T.astype(np.float32)
    return shift(tilted, np.array([0, 0, random.uniform(-RAISED_M, LOWERED_M)]))


def other_view(sensor: Sensor, random: Rng) -> Sensor:
    """Return a sensor both of whose edges of the view are moved."""
    most = min(EDGE_SHIFT_DEG, EDGE_SHIFT * (sensor.fov_up - sensor.fov_down))
    up, down = map(float, random.uniform(-most, most, 2))
    return replace(sensor, fov_up=sensor.fov_up + up, fov_down=sensor.fov_down + down)


def fewer_beams(channels: Float, random: Rng) -> Float:
    """Return channels (C, H, W) of which some rows are kept, evenly spaced or any."""
    height = channels.shape[1]
    count = max(1, round(height * random.uniform(LEAST_ROWS, MOST_ROWS)))
    if random.random() < 0.5:
        rows = np.floor((np.arange(count) + random.random()) * height / count).astype(np.intp)
    else:
        rows = random.permutation(height)[:count]
    kept = np.zeros_like(channels)
    kept[:, rows] = channels[:, rows]
    return kept
