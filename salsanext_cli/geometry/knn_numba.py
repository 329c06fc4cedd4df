# SPDX-License-Identifier: MIT
"""kNN refinement compiled for the CPU.

Where a window holds one label only, no vote is needed. The other points are refined in blocks, and
each step runs over a whole block before the next begins: the compiler can vectorise loops without a
branch.
"""

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.compiled.kernels import argument, compiled, parallel_for_slices
from salsanext_cli.records import Float, Int

Candidates = npt.NDArray[np.int64]

BLOCK = 256
"""Number of points per block, which fits the fastest cache."""
LAST = np.int64(2**63 - 256)
"""Candidate farther than all others, with label 0."""


def refine(
    pixel_of_point: Int,
    point_range: Float,
    ranges: Float,
    labels: TrainIds,
    width: int,
    half: int,
    offsets: Int,
    weights: Float,
    k: int,
    cutoff: float,
) -> TrainIds:
    """Return the label of every point.

    Ranges and labels are those of an image of this width, flattened after a frame of `half` pixels
    was added, so that no step has to test for its border; see `KnnParameters.candidates`.
    """
    pixel_of_point = argument(pixel_of_point, np.int32)
    point_range = argument(point_range, np.float32)
    frame = half * (width + 2 * half) + half
    mixed = np.empty(labels.size - 2 * frame, np.bool_)
    refined = np.empty(len(pixel_of_point), np.uint8)
    image = (ranges, labels, mixed, width, half)
    votes = (offsets, weights, k, np.float32(cutoff))

    def mark(part: slice) -> None:
        mark_mixed(labels, frame + part.start, offsets, mixed[part])

    def vote(part: slice) -> None:
        refine_points(pixel_of_point[part], point_range[part], *image, *votes, refined[part])

    parallel_for_slices(mark, mixed.size)
    parallel_for_slices(vote, len(refined))
    return refined


@compiled
def mark_mixed(labels: TrainIds, first: int, offsets: Int, mixed: npt.NDArray[np.bool_]) -> None:
    """Write whether a pixel's window holds a label above 0 other than the pixel's own."""
    size = len(mixed)
    for i in range(size):
        mixed[i] = False
    own = labels[first : first + size]
    for offset in offsets:
        other = labels[first + offset : first + offset + size]
        for i in range(size):
            mixed[i] |= (other[i] != own[i]) & (other[i] != 0)


@compiled
def refine_points(
    pixel_of_point: Int,
    point_range: Float,
    ranges: Float,
    labels: TrainIds,
    mixed: npt.NDArray[np.bool_],
    width: int,
    half: int,
    offsets: Int,
    weights: Float,
    k: int,
    cutoff: np.float32,
    refined: TrainIds,
) -> None:
    """Write the label of each point: 0 without a pixel, else its pixel's or a block's vote."""
    frame = half * (width + 2 * half) + half
    chosen = np.empty(BLOCK, np.int32)
    centre = np.full(BLOCK, frame, np.int32)
    own_range = np.zeros(BLOCK, np.float32)
    voted = np.empty(BLOCK, np.int32)
    size = 0
    for i in range(len(refined)):
        pixel = pixel_of_point[i]
        position = max(pixel, 0)
        position += np.uint32(position) // np.uint32(width) * 2 * half
        refined[i] = labels[position + frame] if pixel >= 0 else 0
        if pixel >= 0 and mixed[position]:
            chosen[size] = i
            centre[size] = position + frame
            own_range[size] = point_range[i]
            size += 1
        if size == BLOCK or (size > 0 and i == len(refined) - 1):
            vote_of_block(centre, own_range, ranges, labels, offsets, weights, k, cutoff, voted)
            for j in range(size):
                refined[chosen[j]] = voted[j]
            size = 0


@compiled
def vote_of_block(
    centre: Int,
    own_range: Float,
    ranges: Float,
    labels: TrainIds,
    offsets: Int,
    weights: Float,
    k: int,
    cutoff: np.float32,
    voted: Int,
) -> None:
    """Write the label of each point of a block by the vote of its neighbours.

    A candidate is one integer, so that one comparison ranks it: from the highest bit the distance
    (the bits of a float ≥ 0 are in its order), the place in the window, the label.
    """
    distance = np.empty(BLOCK, np.float32)
    distance_bits = distance.view(np.int32)
    label = np.empty(BLOCK, np.int32)
    candidate = np.empty(BLOCK, np.int64)
    nearest = np.empty((k, BLOCK), np.int64)
    for place in range(k):
        for j in range(BLOCK):
            nearest[place, j] = labels[centre[j]] if place == 0 else LAST
    for n in range(len(offsets)):
        offset, weight = offsets[n], weights[n]
        for j in range(BLOCK):
            distance[j] = ranges[centre[j] + offset]
            label[j] = labels[centre[j] + offset]
        for j in range(BLOCK):
            distance[j] = abs(distance[j] - own_range[j]) * weight
            label[j] *= distance[j] <= cutoff
        for j in range(BLOCK):
            candidate[j] = (np.int64(distance_bits[j]) << 32) | (n << 8) | label[j]
        for place in range(1, k):
            keep_nearer(nearest[place], candidate)
    majority(nearest, voted)


@compiled
def keep_nearer(nearest: Candidates, candidate: Candidates) -> None:
    """Keep the nearer one in this place; the farther one becomes the candidate of the next."""
    for j in range(BLOCK):
        here, new = nearest[j], candidate[j]
        nearest[j] = min(here, new)
        candidate[j] = max(here, new)


@compiled
def majority(nearest: Candidates, voted: Int) -> None:
    """Write the most frequent label above 0, the lowest of equally frequent ones; 0 without any."""
    voters = np.empty(nearest.shape, np.int32)
    count = np.empty(BLOCK, np.int32)
    for one in range(len(voters)):
        for j in range(BLOCK):
            voters[one, j] = nearest[one, j] & 255
    for j in range(BLOCK):
        voted[j] = 255
    for one in range(len(voters)):
        for j in range(BLOCK):
            count[j] = 0
        for other in range(len(voters)):
            for j in range(BLOCK):
                count[j] += np.int32(voters[other, j] == voters[one, j])
        for j in range(BLOCK):
            score = 256 * count[j] + 255 - voters[one, j] if voters[one, j] > 0 else 255
            voted[j] = max(voted[j], score)
    for j in range(BLOCK):
        voted[j] = 255 - (voted[j] & 255)
