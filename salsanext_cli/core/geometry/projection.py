# SPDX-License-Identifier: MIT
"""Range images of scans (paper eq. 1).

::

    u = ½ [1 − atan2(y, x)/π] W
    v = [1 − (asin(z/r) − f_down)/(f_up − f_down)] H

Both are rounded down and clamped to the image. The nearest point wins a pixel; in a tie, the first
in the scan. All arithmetic after the arctangents is float32, as in the published code, so that
points on a pixel border fall to the same side.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.core.geometry.sensor_frame import without_ego
from salsanext_cli.core.records import (
    CHANNELS,
    MAX_INTENSITY,
    MAX_RANGE_M,
    Float,
    Int,
    RangeImage,
    Scan,
)
from salsanext_cli.core.sensors.sensor import Sensor

ZERO = np.float32(0)
HALF = np.float32(0.5)
ONE = np.float32(1)
PI = np.float32(math.pi)
TAN_22_5 = math.sqrt(2) - 1
Value = TypeVar("Value", bound=np.generic)


class ImageGeometry(NamedTuple):
    """Field of view and size of a range image, as the kernels take them.

    Attributes
    ----------
    fov_down, fov : float32
        Lower edge and extent of the field of view in radians.
    height, width : float32
        Size in pixels.
    drops_outside : bool
        Whether points outside the field of view have no pixel.
    """

    fov_down: np.float32
    fov: np.float32
    height: np.float32
    width: np.float32
    drops_outside: bool


def project(scan: Scan, sensor: Sensor) -> RangeImage:
    """Project a scan onto the sensor's range image (paper eq. 1).

    A point has no pixel (index -1, range 0) if a coordinate is NaN or infinite, if it lies at the
    origin or beyond 1000 km, or if it is outside the field of view of a sensor that drops such
    points. An intensity that is NaN, infinite or beyond a million becomes 0 in the image.

    Parameters
    ----------
    scan : Scan
        Any number of points.
    sensor : Sensor
        Mounting, field of view and image size.

    Returns
    -------
    RangeImage
        Pixels of the points, and their channels.
    """
    scan = without_ego(scan, sensor)
    height = sensor.height
    width = sensor.width
    count = len(scan)
    geometry = _geometry(sensor)
    points = argument(scan.points, np.float32).reshape(-1)
    intensity = argument(scan.intensity, np.float32)
    pixel_of_point = np.empty(count, np.int32)
    point_range = np.empty(count, np.float32)
    point_of_pixel = np.full(height * width, -1, np.int32)
    channels = np.zeros((len(CHANNELS), height * width), np.float32)

    def find(numbers: slice) -> None:
        coordinates = points[3 * numbers.start : 3 * numbers.stop]
        find_pixels(coordinates, geometry, pixel_of_point[numbers], point_range[numbers])

    def fill(pixels: slice) -> None:
        fill_channels(
            point_of_pixel, pixels.start, pixels.stop, point_range, points, intensity, channels
        )

    parallel_for_slices(find, count)
    keep_nearest(pixel_of_point, point_range, point_of_pixel)
    parallel_for_slices(fill, height * width)
    return RangeImage(
        channels.reshape(-1, height, width),
        pixel_of_point,
        point_of_pixel.reshape(height, width),
        point_range,
    )


def _geometry(sensor: Sensor) -> ImageGeometry:
    """Return the geometry of the images of a sensor."""
    up = math.radians(sensor.fov_up)
    down = math.radians(sensor.fov_down)
    return ImageGeometry(
        fov_down=np.float32(down),
        fov=np.float32(up - down),
        height=np.float32(sensor.height),
        width=np.float32(sensor.width),
        drops_outside=sensor.out_of_view == "drop",
    )


@compiled
def arctan2(y: float, x: float) -> float:
    """Return atan2(y, x) within 1e-11, in float64 arithmetic alone."""
    # The function of the C library differs in the last bit between platforms and does not
    # vectorise. Turning by 45° brings the ratio of the coordinates below tan 22.5°, where 13 terms
    # of atan t = t − t³/3 + t⁵/5 − … suffice.
    steep = abs(y) > abs(x)
    small = abs(x) if steep else abs(y)
    large = abs(y) if steep else abs(x)
    turned = small > TAN_22_5 * large
    numerator = small - large if turned else small
    denominator = small + large if turned else large
    t = numerator / (denominator if denominator > 0 else 1.0)
    q = t * t
    series = 1 / 21 + q * (-1 / 23 + q * (1 / 25))
    series = 1 / 13 + q * (-1 / 15 + q * (1 / 17 + q * (-1 / 19 + q * series)))
    series = 1 / 5 + q * (-1 / 7 + q * (1 / 9 + q * (-1 / 11 + q * series)))
    angle = t * (1 + q * (-1 / 3 + q * series)) + (math.pi / 4 if turned else 0.0)
    angle = math.pi / 2 - angle if steep else angle
    angle = math.pi - angle if math.copysign(1.0, x) < 0 else angle
    return math.copysign(angle, y)


@compiled
def find_pixels(
    points: Float, geometry: ImageGeometry, pixel_of_point: Int, point_range: Float
) -> None:
    """Write flat pixel index and range of each point (paper eq. 1).

    Parameters
    ----------
    points : (3 N,) float32
        Coordinates in the frame of the sensor, point by point, in metres.
    geometry : ImageGeometry
        Field of view and size of the image.
    pixel_of_point : (N,) int32
        Result: flat pixel index, -1 for none.
    point_range : (N,) float32
        Result: range in metres, 0 without a pixel.
    """
    fov_down = geometry.fov_down
    fov = geometry.fov
    height = geometry.height
    width = geometry.width
    for i in range(len(point_range)):
        x = points[3 * i]
        y = points[3 * i + 1]
        z = points[3 * i + 2]
        a = np.float64(x)
        b = np.float64(y)
        c = np.float64(z)
        distance = np.float32(math.sqrt(a * a + b * b + c * c))
        slope = np.float64(z / distance)
        yaw = np.float32(arctan2(b, a))
        pitch = np.float32(arctan2(slope, math.sqrt((1 - slope) * (1 + slope))))
        u = HALF * (ONE - yaw / PI) * width
        v = (ONE - (pitch - fov_down) / fov) * height
        in_view = (v >= ZERO) & (v <= height)
        seen = (
            (distance > ZERO) & (distance <= MAX_RANGE_M) & (in_view | (not geometry.drops_outside))
        )
        u = u if u > ZERO else ZERO
        v = v if v > ZERO else ZERO
        u = u if u < width else width - ONE
        v = v if v < height else height - ONE
        pixel = np.int32(v) * np.int32(width) + np.int32(u)
        pixel_of_point[i] = pixel if seen else np.int32(-1)
        point_range[i] = distance if seen else ZERO


@compiled
def keep_nearest(pixel_of_point: Int, point_range: Float, point_of_pixel: Int) -> None:
    """Write the nearest point of each pixel, the first in a tie.

    Parameters
    ----------
    pixel_of_point : (N,) int32
        Flat pixel index of each point, -1 for none.
    point_range : (N,) float32
        Range of each point in metres.
    point_of_pixel : (H · W,) int32
        Result, in place of -1 in pixels with a point.
    """
    for i in range(len(pixel_of_point)):
        pixel = pixel_of_point[i]
        if pixel >= 0:
            holder = point_of_pixel[pixel]
            if holder < 0 or point_range[i] < point_range[holder]:
                point_of_pixel[pixel] = i


@compiled
def fill_channels(
    point_of_pixel: Int,
    start: int,
    stop: int,
    point_range: Float,
    points: Float,
    intensity: Float,
    channels: Float,
) -> None:
    """Write range, x, y, z and intensity of each pixel's point; empty pixels stay as they are.

    Parameters
    ----------
    point_of_pixel : (H · W,) int32
        Index of the point of each pixel, -1 where empty.
    start : int
        First pixel to fill.
    stop : int
        The pixel after the last.
    point_range : (N,) float32
        Range of each point in metres.
    points : (3 N,) float32
        Coordinates, point by point, in metres.
    intensity : (N,) float32
        Intensity of each point.
    channels : (5, H · W) float32
        Result.
    """
    for pixel in range(start, stop):
        i = point_of_pixel[pixel]
        if i >= 0:
            channels[0, pixel] = point_range[i]
            channels[1, pixel] = points[3 * i]
            channels[2, pixel] = points[3 * i + 1]
            channels[3, pixel] = points[3 * i + 2]
            usable = abs(intensity[i]) <= MAX_INTENSITY
            channels[4, pixel] = intensity[i] if usable else ZERO


def points_from_pixels(
    pixel_values: npt.NDArray[Value], pixel_of_point: Int, empty: npt.ArrayLike
) -> npt.NDArray[Value]:
    """Return the value of the pixel of every point.

    Parameters
    ----------
    pixel_values : (H, W) or (C, H, W) array
        Values of the pixels.
    pixel_of_point : (N,) int32
        Flat pixel index of every point, -1 for none.
    empty : number or (C,) array
        Value of points without a pixel.

    Returns
    -------
    (N,) or (N, C) array
        Of the same dtype.
    """
    flat = pixel_values.reshape((*pixel_values.shape[:-2], -1))
    point_values: npt.NDArray[Value] = flat.T[pixel_of_point]
    point_values[pixel_of_point < 0] = empty
    return point_values


def pixels_from_points(
    point_values: npt.NDArray[Value], point_of_pixel: Int, empty: npt.ArrayLike = 0
) -> npt.NDArray[Value]:
    """Return the value of the nearest point of every pixel.

    Parameters
    ----------
    point_values : (N, …) array
        Values of the points.
    point_of_pixel : (H, W) int32
        Index of the nearest point of every pixel, -1 where empty.
    empty : number or array
        Value of empty pixels.

    Returns
    -------
    (H, W, …) array
        Of the same dtype.
    """
    # Index -1 selects the value that is appended.
    last = np.full((1, *point_values.shape[1:]), empty, point_values.dtype)
    return np.concatenate([point_values, last])[point_of_pixel]
