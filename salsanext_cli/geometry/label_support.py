# SPDX-License-Identifier: MIT
"""Support of a pixel's label by the pixels around it, compiled for the CPU."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.compiled.kernels import argument, compiled, parallel_for_slices
from salsanext_cli.records import Float, Int, RangeImage

ROWS, COLUMNS, STEP = 4, 8, 2
"""Pixels of the window on each side, of which every second row and column counts."""
NEAR_M, NEAR_SHARE = 1.0, 0.05
"""Ranges that differ by less, or by this share, are of the same surface."""
COST = 8
"""Time that a window takes, in those of a point's projection."""


def label_support(image: RangeImage, probabilities: Float, labels: TrainIds, pixels: Int) -> Float:
    """Return the mean probability of a label among a pixel and those around it at its range.

    Of a window of 9 × 17 pixels, which goes on around the image, every second row and column
    counts; in an image that is narrower, a column may count twice.

    `probabilities` (C, H, W) float32; `labels` (M,) uint8, train ids; `pixels` (M,) int32, occupied
    pixels, v · W + u, that the labels are of.

    Returns (M,) float32.
    """
    ranges, softmax = argument(image.channels[0], np.float32), argument(probabilities, np.float32)
    labels, pixels = argument(labels, np.uint8), argument(pixels, np.int32)
    found = np.empty(len(labels), np.float32)

    def describe(part: slice) -> None:
        mean_in_windows(ranges, softmax, labels[part], pixels[part], found[part])

    parallel_for_slices(describe, len(labels), COST)
    return found


@compiled
def mean_in_windows(
    ranges: Float, probabilities: Float, labels: TrainIds, pixels: Int, found: Float
) -> None:
    """Write what `label_support` returns."""
    height, width = ranges.shape
    # A table: a division for each pixel of a window would take longer than the rest.
    columns = np.arange(-COLUMNS, width + COLUMNS) % width
    for i in range(len(labels)):
        v, u = pixels[i] // width, pixels[i] % width
        own, of_label = ranges[v, u], probabilities[labels[i]]
        most = max(NEAR_M, NEAR_SHARE * own)
        count, total = 0, 0.0
        for row in range(v - ROWS, v + ROWS + 1, STEP):
            if 0 <= row < height:
                for column in columns[u : u + 2 * COLUMNS + 1 : STEP]:
                    if ranges[row, column] > 0 and abs(ranges[row, column] - own) <= most:
                        count += 1
                        total += of_label[row, column]
        found[i] = total / count


def region_means(image: RangeImage, classes: TrainIds, values: Float) -> Float:
    """Return the mean of a value over the region that each pixel belongs to.

    A region is of occupied pixels of one class, each beside the next, in eight directions, or the
    next but one in its row or column. Regions go on around the image.

    `classes` (H, W) uint8; `values` (H, W) float32.

    Returns (H, W) float32, of empty pixels their own value.
    """
    found = np.empty(values.shape, np.float32)
    given = argument(classes, np.uint8), argument(values, np.float32)
    mean_of_regions(argument(image.channels[0] > 0, np.bool_), *given, found)
    return found


@compiled
def mean_of_regions(
    occupied: npt.NDArray[np.bool_], classes: TrainIds, values: Float, found: Float
) -> None:
    """Write what `region_means` returns: a union-find over the pixels, the lowest is the root."""
    height, width = occupied.shape
    parent = np.arange(height * width)
    for v in range(height):
        for u in range(width):
            if not occupied[v, u]:
                continue
            for dv, du in ((0, -1), (0, -2), (-1, -1), (-1, 0), (-1, 1), (-2, 0)):
                row, column = v + dv, (u + du) % width
                if row < 0 or not occupied[row, column] or classes[row, column] != classes[v, u]:
                    continue
                one, other = v * width + u, row * width + column
                while parent[one] != one:
                    parent[one] = parent[parent[one]]
                    one = parent[one]
                while parent[other] != other:
                    parent[other] = parent[parent[other]]
                    other = parent[other]
                parent[max(one, other)] = min(one, other)
    count, total = np.zeros(parent.size), np.zeros(parent.size)
    for i in range(parent.size):
        # A parent is lower than its child, so it has its root already.
        parent[i] = parent[parent[i]]
        count[parent[i]] += 1
        total[parent[i]] += values[i // width, i % width]
    for i in range(parent.size):
        found[i // width, i % width] = total[parent[i]] / count[parent[i]]
