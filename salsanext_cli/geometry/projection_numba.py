# SPDX-License-Identifier: MIT
"""Projection compiled for the CPU: angles in slices, one pass of z-buffer, one gather."""

from __future__ import annotations

import math

import numpy as np

from salsanext_cli.geometry.compiled import compiled, in_slices
from salsanext_cli.geometry.projection import View
from salsanext_cli.records import CHANNELS, Float, Int, RangeImage, Scan

ONE, HALF, ZERO = np.float32(1), np.float32(0.5), np.float32(0)
PI = np.float32(math.pi)
LARGEST = np.finfo(np.float32).max
TAN_22_5 = math.sqrt(2) - 1


def project(scan: Scan, view: View) -> RangeImage:
    """Project a scan; see `geometry.projection.project`."""
    height, width, count = int(view.height), int(view.width), len(scan)
    points = np.ascontiguousarray(scan.points)
    intensity = np.ascontiguousarray(scan.intensity)
    pixel_of_point = np.empty(count, np.int32)
    point_range = np.empty(count, np.float32)
    numbers = (view.fov_down, view.fov, view.height, view.width, view.drop)
    in_slices(_find_pixels, count, points, pixel_of_point, point_range, *numbers)

    point_of_pixel = np.full(height * width, -1, np.int32)
    _keep_nearest(pixel_of_point, point_range, point_of_pixel)
    channels = np.empty((len(CHANNELS), height * width), np.float32)
    in_slices(
        _fill_channels, height * width, point_of_pixel, points, intensity, point_range, channels
    )
    return RangeImage(
        channels.reshape(-1, height, width),
        pixel_of_point,
        point_of_pixel.reshape(height, width),
        point_range,
    )


@compiled
def arctan2(y: float, x: float) -> float:
    """Return atan2(y, x) within 1e-11, by float64 arithmetic alone.

    The library's function is correct to the last bit or not, depending on the platform, and the
    compiler cannot vectorise it. Here the ratio of the smaller to the larger coordinate is brought
    below tan 22.5° by turning 45°, where 13 terms of atan t = t − t³/3 + t⁵/5 − … suffice.
    """
    small, large = min(abs(x), abs(y)), max(abs(x), abs(y))
    turned = small > TAN_22_5 * large
    numerator = small - large if turned else small
    denominator = small + large if turned else large
    t = numerator / (denominator if denominator > 0 else 1.0)
    q = t * t
    series = 1 / 21 + q * (-1 / 23 + q * (1 / 25))
    series = 1 / 13 + q * (-1 / 15 + q * (1 / 17 + q * (-1 / 19 + q * series)))
    series = 1 / 5 + q * (-1 / 7 + q * (1 / 9 + q * (-1 / 11 + q * series)))
    angle = t * (1 + q * (-1 / 3 + q * series)) + (math.pi / 4 if turned else 0.0)
    angle = math.pi / 2 - angle if abs(y) > abs(x) else angle
    angle = math.pi - angle if math.copysign(1.0, x) < 0 else angle
    return math.copysign(angle, y)


@compiled
def _find_pixels(
    start: int,
    stop: int,
    points: Float,
    pixel_of_point: Int,
    point_range: Float,
    fov_down: np.float32,
    fov: np.float32,
    height: np.float32,
    width: np.float32,
    drop: bool,
) -> None:
    """Write flat pixel index and range of each point (paper eq. 1)."""
    for i in range(start, stop):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        distance = np.float32(math.sqrt(x * x + y * y + z * z))
        measured = ZERO < distance <= LARGEST
        slope = np.float64(points[i, 2] / distance)
        yaw = np.float32(arctan2(y, x))
        pitch = np.float32(arctan2(slope, math.sqrt((1 - slope) * (1 + slope))))
        u = HALF * (ONE - yaw / PI) * width
        v = (ONE - (pitch - fov_down) / fov) * height
        seen = measured and not (drop and (v < ZERO or v > height))
        u = min(max(math.floor(u if seen else ZERO), ZERO), width - ONE)
        v = min(max(math.floor(v if seen else ZERO), ZERO), height - ONE)
        pixel_of_point[i] = np.int32(v) * np.int32(width) + np.int32(u) if seen else -1
        point_range[i] = distance if seen else ZERO


@compiled
def _keep_nearest(pixel_of_point: Int, point_range: Float, point_of_pixel: Int) -> None:
    """Write the nearest point of each pixel; the first of equally near ones stays."""
    for i in range(len(pixel_of_point)):
        pixel = pixel_of_point[i]
        if pixel >= 0:
            holder = point_of_pixel[pixel]
            if holder < 0 or point_range[i] < point_range[holder]:
                point_of_pixel[pixel] = i


@compiled
def _fill_channels(
    start: int,
    stop: int,
    point_of_pixel: Int,
    points: Float,
    intensity: Float,
    point_range: Float,
    channels: Float,
) -> None:
    """Write range, x, y, z and intensity of each pixel's point; 0 where there is none."""
    for pixel in range(start, stop):
        i = point_of_pixel[pixel]
        if i < 0:
            channels[:, pixel] = ZERO
        else:
            channels[0, pixel] = point_range[i]
            channels[1, pixel] = points[i, 0]
            channels[2, pixel] = points[i, 1]
            channels[3, pixel] = points[i, 2]
            channels[4, pixel] = intensity[i] if math.isfinite(intensity[i]) else ZERO
