# SPDX-License-Identifier: MIT
"""Scans of a street between walls and posts, without a network or files."""

import numpy as np

from salsanext_cli import Scan

HEIGHT = 1.7
LOW_HEIGHT = 1.2


def street_points(azimuth, elevation, height, farthest, noise):
    """Return the points (N, 3) that rays in some directions (radians) hit.

    `farthest` bounds their ranges, in metres, and `noise` (N,) is added to these. The nearer of the
    walls has most of them.
    """
    flat = np.cos(elevation)
    rays = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
    with np.errstate(divide="ignore"):
        ground = np.where(rays[:, 2] < 0, -height / rays[:, 2], np.inf)
        wall = np.where(rays[:, 1] > 0, 6, -9) / rays[:, 1]
    ranges = np.minimum(np.minimum(ground, wall), farthest) + noise
    return (rays * ranges[:, None]).astype(np.float32)


def street(beams: int, height: float = HEIGHT, seed: int = 0) -> Scan:
    """Points of a rotating sensor on a street between walls and posts; beams 0: no two alike."""
    random = np.random.default_rng(seed)
    teeth = np.linspace(-24, 2, beams) if beams else random.uniform(-24, 2, 20_000)
    elevation = np.radians(random.choice(teeth, 20_000))
    azimuth = random.uniform(-np.pi, np.pi, 20_000)
    posts = np.where(azimuth * 6 % 1 < 0.1, random.uniform(5, 30), 60)
    points = street_points(azimuth, elevation, height, posts, random.normal(0, 0.01, 20_000))
    return Scan(points, random.random(20_000, np.float32))


def low_street(seed: int) -> Scan:
    """Return a scan of a low sensor with another field of view and fewer points."""
    random = np.random.default_rng(seed)
    elevation = np.radians(random.choice(np.linspace(-16, 14, 16), 6000))
    azimuth = random.uniform(-np.pi, np.pi, 6000)
    posts = np.where(azimuth * 6 % 1 < 0.1, random.uniform(5, 30), 60)
    points = street_points(azimuth, elevation, LOW_HEIGHT, posts, random.normal(0, 0.01, 6000))
    return Scan(points, random.random(6000, np.float32))


def moved(scan, place):
    """Return the scan in a frame in which the sensor is at a place."""
    return Scan((scan.points + np.array(place)).astype(np.float32), scan.intensity)
