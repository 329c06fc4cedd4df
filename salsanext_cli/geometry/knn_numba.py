# SPDX-License-Identifier: MIT
"""kNN refinement compiled for the CPU.

Most windows hold one label only, whose vote needs no counting: the smallest and largest label of
each window are found first, and neighbours are searched for the other points alone.
"""

from __future__ import annotations

import numpy as np

from salsanext_cli.geometry.compiled import compiled, in_slices
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.records import Float, Int, TrainIds


def refine(
    ranges: Float,
    labels: TrainIds,
    pixel_of_point: Int,
    point_range: Float,
    class_count: int,
    parameters: KnnParameters,
) -> TrainIds:
    """Return the label of every point; see `geometry.knn.knn_refine`."""
    refined = np.empty(len(pixel_of_point), np.uint8)
    in_slices(
        _vote,
        len(pixel_of_point),
        ranges,
        labels,
        pixel_of_point,
        point_range,
        class_count,
        parameters.k,
        np.float32(parameters.cutoff),
        parameters.weights(),
        refined,
    )
    return refined


@compiled
def _vote(
    start: int,
    stop: int,
    ranges: Float,
    labels: TrainIds,
    pixel_of_point: Int,
    point_range: Float,
    class_count: int,
    k: int,
    cutoff: np.float32,
    weights: Float,
    refined: TrainIds,
) -> None:
    """Write the label of each point of the slice."""
    height, width = ranges.shape
    half = len(weights) // 2
    # In an image narrower than the window no pixel may come round twice.
    left, right = min(half, (width - 1) // 2), min(half, width // 2)
    distances = np.empty(k + 1, np.float32)
    nearest = np.empty(k + 1, np.uint8)
    votes = np.zeros(class_count, np.int32)
    for i in range(start, stop):
        pixel = pixel_of_point[i]
        if pixel < 0:
            refined[i] = 0
            continue
        row, column = pixel // width, pixel % width
        distances[0] = 0
        nearest[0] = labels[row, column]
        found = 1
        for dy in range(-min(half, row), min(half, height - 1 - row) + 1):
            for dx in range(-left, right + 1):
                u = column + dx
                u = u + width if u < 0 else u - width if u >= width else u
                candidate = ranges[row + dy, u]
                distance = abs(candidate - point_range[i]) * weights[dy + half, dx + half]
                if candidate <= 0 or (dy == 0 and dx == 0) or distance > cutoff:
                    continue
                if found == k and distance >= distances[k - 1]:
                    continue
                place = found
                while place > 1 and distance < distances[place - 1]:
                    distances[place] = distances[place - 1]
                    nearest[place] = nearest[place - 1]
                    place -= 1
                distances[place] = distance
                nearest[place] = labels[row + dy, u]
                found = min(found + 1, k)
        for j in range(found):
            votes[nearest[j]] += 1
        votes[0] = 0
        best = nearest[0]
        for j in range(found):
            label = nearest[j]
            if votes[label] > votes[best] or (votes[label] == votes[best] and 0 < label < best):
                best = label
        refined[i] = best
        for j in range(found):
            votes[nearest[j]] = 0
