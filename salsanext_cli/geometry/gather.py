# SPDX-License-Identifier: MIT
"""Values of pixels gathered onto points, and values of points onto pixels."""

from typing import TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Int

Value = TypeVar("Value", bound=np.generic)


def points_from_pixels(
    of_pixels: npt.NDArray[Value], pixel_of_point: Int, empty: npt.ArrayLike
) -> npt.NDArray[Value]:
    """Give every point its pixel's value.

    `of_pixels` (H, W) or (C, H, W), values of the pixels, of any dtype; `pixel_of_point` (N,)
    int32, flat pixel index, -1 without a pixel; `empty`: value of the points without a pixel.

    Returns (N,) or (N, C), same dtype, a new array.
    """
    flat = of_pixels.reshape(*of_pixels.shape[:-2], -1)
    of_points: npt.NDArray[Value] = flat.T[pixel_of_point]
    of_points[pixel_of_point < 0] = empty
    return of_points


def pixels_from_points(
    of_points: npt.NDArray[Value], point_of_pixel: Int, empty: npt.ArrayLike = 0
) -> npt.NDArray[Value]:
    """Give every pixel its nearest point's value.

    `of_points` (N, …), values of the points, of any dtype; `point_of_pixel` (H, W) int32, index of
    the nearest point, -1 where a pixel is empty; `empty`: value of the empty pixels.

    Returns (H, W, …), same dtype, a new array.
    """
    # Index -1 finds the value that is appended.
    last = np.full((1, *of_points.shape[1:]), empty, of_points.dtype)
    of_pixels: npt.NDArray[Value] = np.concatenate([of_points, last])[point_of_pixel]
    return of_pixels
