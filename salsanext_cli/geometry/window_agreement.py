# SPDX-License-Identifier: MIT
"""Agreement of a point with the pixels around its own, compiled for the CPU."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import TrainIds
from salsanext_cli.kernels import argument, compiled, parallel_for_slices
from salsanext_cli.records import Float, Int, RangeImage

HALF = 2
"""Pixels of the window on each side of a point's own."""


def window_agreement(
    image: RangeImage, log_range: Float, probabilities: Float, labels: TrainIds, pixels: Int
) -> Float:
    """Describe the occupied pixels in a window of 5 × 5, which goes on around the image.

    Parameters
    ----------
    image : RangeImage
    log_range : (H, W) float32
    probabilities : (C, H, W) float32
    labels : (M,) uint8
        Train ids of points.
    pixels : (M,) int32
        Their pixels.

    Returns
    -------
    (M, 4) float32
        Share of the pixels whose most probable class is the point's label; standard deviation of
        their log range; their number as a share of all; mean probability of the point's label.
    """
    occupied = argument(image.channels[0] > 0, np.bool_)
    classes = argument(probabilities.argmax(axis=0), np.uint8)
    # A pixel's probabilities side by side, as the loop reads them.
    by_pixel = argument(np.moveaxis(probabilities, 0, 2), np.float32)
    given = occupied, classes, argument(log_range, np.float32), by_pixel
    labels, pixels = argument(labels, np.uint8), argument(pixels, np.int32)
    found = np.empty((len(labels), 4), np.float32)

    def describe(part: slice) -> None:
        describe_windows(*given, labels[part], pixels[part], found[part])

    parallel_for_slices(describe, len(labels))
    return found


@compiled
def describe_windows(
    occupied: npt.NDArray[np.bool_],
    classes: TrainIds,
    log_range: Float,
    by_pixel: Float,
    labels: TrainIds,
    pixels: Int,
    found: Float,
) -> None:
    """Write what `window_agreement` returns."""
    height, width = occupied.shape
    for i in range(len(labels)):
        v, u, label = pixels[i] // width, pixels[i] % width, labels[i]
        count, same = 0, 0
        total, squares, probability = 0.0, 0.0, 0.0
        for row in range(max(v - HALF, 0), min(v + HALF + 1, height)):
            for step in range(-HALF, HALF + 1):
                column = (u + step) % width
                if occupied[row, column]:
                    count += 1
                    same += classes[row, column] == label
                    value = np.float64(log_range[row, column])
                    total += value
                    squares += value * value
                    probability += by_pixel[row, column, label]
        mean = total / max(count, 1)
        found[i, 0] = same / max(count, 1)
        found[i, 1] = np.sqrt(max(squares / max(count, 1) - mean * mean, 0.0))
        found[i, 2] = count / (2 * HALF + 1) ** 2
        found[i, 3] = probability / max(count, 1)
