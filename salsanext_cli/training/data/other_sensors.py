# SPDX-License-Identifier: MIT
"""Changes of a scan or its range image that imitate another sensor or another mounting.

Their sizes cover the beams, fields of view and mountings of sensors on the market, and what remains
after `match_intensity`. The frequencies of holes are those of `benchmarks/weights/hole_shares.py`:
means over real scans of Pandar64 (second drive of PandaSet), VLP-32C (front sectors of RWTH
Aachen), OS0-128, OS1-128 and OS2-32 (captures of Ouster) in 64 x 512 pixels. They do not depend on
the intensity: dark surfaces have more holes in some of these sensors and fewer in others.
"""

from dataclasses import replace

import numpy as np

from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.records import Float, Indices, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.training.data.augment import shift

Rng = np.random.Generator

LOG_GAIN = 0.3  # Standard deviation of the logarithm of the gain of intensities
LOG_GAMMA = 0.3  # Of the logarithm of their exponent
RANGE_POWER = 0.15  # Of the power of the range by which they change
OFFSET = 0.05  # Of their offset
RESPONSE_RANGE_M = 10.0  # Range at which a power of the range has no effect
LOWERED_M = 0.55  # Largest shift of a sensor down
RAISED_M = 0.9  # Largest shift of a sensor up
TILT_DEG = 1.0  # Standard deviation of the tilt of a sensor
EDGE_SHIFT_DEG = 6.0  # Largest shift of an edge of the field of view
EDGE_SHIFT = 0.25  # Its limit as a share of the field of view
MIN_ROWS = 0.25  # Least share of remaining rows
MAX_ROWS = 0.75  # Largest share of remaining rows
MAX_RUN = 4  # Largest width of a hole between two measured pixels of a row
EDGE_RATIO = 1.1  # Ratio of the ranges on both sides above which an edge is between them
RANGE_EDGES_M = (5.0, 10.0, 20.0, 40.0)  # Bounds of the bins of the range on the nearer side
HOLE_SHARES = np.array([[0.064, 0.026, 0.026, 0.051, 0.067], [0.119, 0.114, 0.115, 0.149, 0.176]])
"""Share of holes on surfaces and at edges, by range."""
CONTINUED = 0.42  # Share of holes whose right neighbour is a hole, too
MAX_HOLES = 2.0  # Largest factor of the shares, as of the sensor with the most holes, OS2-32
MAX_JITTER_M = 0.03  # Largest standard deviation of positions, typical for ranges


def change_intensity(scan: Scan, bright: float, random: Rng) -> Scan:
    """Return intensities gain · i^gamma · (range / 10 m)^power + offset, in units of `bright`."""
    gain, gamma = np.exp(random.normal(0, (LOG_GAIN, LOG_GAMMA)))
    power, offset = random.normal(0, (RANGE_POWER, OFFSET))
    ranges, measured = measured_ranges(scan.points)
    response = np.where(measured, ranges / RESPONSE_RANGE_M, 1.0) ** power
    positive = np.clip(scan.intensity, 0, None).astype(np.float64) / bright
    changed = bright * (gain * positive**gamma * response + offset)
    return replace(scan, intensity=changed.astype(np.float32))


def mount_otherwise(points: Float, random: Rng) -> Float:
    """Return points (N, 3) as measured from another height, tilted in any direction."""
    angle = np.radians(random.normal(0, TILT_DEG))
    azimuth = random.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0])
    # Rodrigues' rotation about a level axis
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) - np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    with np.errstate(invalid="ignore", over="ignore"):
        tilted: Float = points @ turn.T.astype(np.float32)
    return shift(tilted, np.array([0, 0, random.uniform(-RAISED_M, LOWERED_M)]))


def other_view(sensor: Sensor, random: Rng) -> Sensor:
    """Return a sensor with both edges of the field of view moved."""
    most = min(EDGE_SHIFT_DEG, EDGE_SHIFT * (sensor.fov_up - sensor.fov_down))
    up, down = map(float, random.uniform(-most, most, 2))
    return replace(sensor, fov_up=sensor.fov_up + up, fov_down=sensor.fov_down + down)


def fewer_beams(channels: Float, random: Rng) -> Float:
    """Return channels (C, H, W) with some rows, evenly spaced or random; the others are empty."""
    height = channels.shape[1]
    count = max(1, round(height * random.uniform(MIN_ROWS, MAX_ROWS)))
    if random.random() < 0.5:
        rows = np.floor((np.arange(count) + random.random()) * height / count).astype(np.intp)
    else:
        rows = random.permutation(height)[:count]
    thinned = np.zeros_like(channels)
    thinned[:, rows] = channels[:, rows]
    return thinned


def hole_cells(ranges: Float) -> Indices:
    """Return the cell of `HOLE_SHARES` of each pixel of ranges (H, W), -1 beyond `MAX_RUN`.

    It depends on the next measured pixels to the left and right, not on the pixel itself.
    """
    sides = np.zeros((2, *ranges.shape), np.float32)
    steps = np.full((2, *ranges.shape), MAX_RUN)
    for step in range(MAX_RUN, 0, -1):
        for side, signed in enumerate((step, -step)):
            neighbour = np.roll(ranges, signed, axis=1)
            np.copyto(sides[side], neighbour, where=neighbour > 0)
            np.copyto(steps[side], step, where=neighbour > 0)
    near = sides.min(axis=0)
    far = sides.max(axis=0)
    cells = np.digitize(near, RANGE_EDGES_M) + (far > EDGE_RATIO * near) * HOLE_SHARES.shape[1]
    between = (near > 0) & (steps.sum(axis=0) - 1 <= MAX_RUN)
    return np.where(between, cells, -1)


def make_holes(channels: Float, random: Rng) -> Float:
    """Return channels (C, H, W), the range first, without pixels that real sensors would lose.

    A pixel is lost with the share of its cell times a factor, or with its left neighbour.
    """
    return lose_pixels(channels, random.uniform(0, MAX_HOLES), random)


def lose_pixels(channels: Float, factor: float, random: Rng) -> Float:
    """Return channels (C, H, W) with holes; their shares are `HOLE_SHARES` times a factor."""
    shares = np.append(HOLE_SHARES, 0.0)[hole_cells(channels[0])] * factor
    chance = random.random(shares.shape)
    is_first = random.random(shares.shape) >= CONTINUED
    source = np.maximum.accumulate(np.where(is_first, np.arange(shares.shape[1]), 0), axis=1)
    lost = np.take_along_axis(chance, source, axis=1) < shares
    return np.where(lost, np.float32(0), channels)


def jitter(points: Float, random: Rng) -> Float:
    """Return points (N, 3) with normal noise on x, y and z; those at the origin stay."""
    deviation = np.float32(random.uniform(0, MAX_JITTER_M))
    noise = deviation * random.standard_normal(points.shape, np.float32)
    return points + noise * (points != 0).any(axis=1, keepdims=True)
