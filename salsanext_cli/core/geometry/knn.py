# SPDX-License-Identifier: MIT
"""Labels of points from the labels of pixels by the nearest neighbours in range (RangeNet++).

The candidates of a point are the pixels of a window around its pixel. A candidate's distance is
``|range of the candidate − range of the point| × (1 − Gaussian of its offset)``; the centre of the
window stands for the point itself, at distance 0. The k nearest candidates up to the cutoff vote
with their labels. Label 0 counts among the k but does not vote; the lowest label wins ties.

The window is periodic in azimuth. Empty pixels and pixels above or below the image are not
candidates. A point without a vote takes the label of its pixel.
"""

from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.core.errors import LabelError, UsageError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.records import Float, Int, Mask, RangeImage

Scalar = TypeVar("Scalar", bound=np.generic)
Candidates = npt.NDArray[np.int64]
BLOCK = 256  # Number of points per block, which fits the fastest cache
FARTHEST = np.int64(2**63 - 256)  # Candidate farther than all others, with label 0


class FramedImage(NamedTuple):
    """Range image in a frame of half a window: periodic in azimuth, empty above and below.

    Attributes
    ----------
    ranges : (P,) float32
        Flat ranges in metres; infinite in empty pixels.
    labels : (P,) uint8
        Flat train ids; 0 in empty pixels.
    is_mixed : (M,) bool
        Whether the window of a pixel holds another label above 0; begins with the first pixel
        inside the frame.
    width : int
        Columns of the image without its frame.
    half : int
        Pixels of the frame on each side.
    """

    ranges: Float
    labels: TrainIds
    is_mixed: Mask
    width: int
    half: int


class VoteRules(NamedTuple):
    """Neighbours that vote.

    Attributes
    ----------
    offsets : (M,) int32
        Flat offsets of the candidates from the pixel of the point.
    weights : (M,) float32
        Factors of their distances.
    k : int
        Number of neighbours, the pixel of the point included.
    cutoff : float32
        Largest distance of a neighbour that votes, in metres.
    """

    offsets: Int
    weights: Float
    k: int
    cutoff: np.float32


def candidates(parameters: KnnParameters, width: int) -> tuple[Int, Float]:
    """Return the candidates of another pixel than that of the point.

    In an image narrower than the window, no pixel is a candidate twice.

    Parameters
    ----------
    parameters : KnnParameters
        Window and Gaussian.
    width : int
        Columns of the image, without its frame of ``window // 2`` pixels.

    Returns
    -------
    offsets : (M,) int32
        Flat offsets in the framed image.
    weights : (M,) float32
        Factors of their distances.
    """
    half = parameters.window // 2
    dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
    chosen = (dx >= -((width - 1) // 2)) & (dx <= width // 2) & ((dx != 0) | (dy != 0))
    offsets = dy * (width + 2 * half) + dx
    gaussian = np.exp(-(dy**2 + dx**2) / (2 * parameters.sigma**2))
    weights = 1 - gaussian / gaussian.sum()
    return offsets[chosen].astype(np.int32), weights[chosen].astype(np.float32)


def knn_refine(
    image: RangeImage,
    pixel_labels: npt.ArrayLike,
    class_count: int = 20,
    parameters: KnnParameters = KnnParameters(),
) -> TrainIds:
    """Label every point by a vote of its nearest neighbours in the range image.

    Parameters
    ----------
    image : RangeImage
        Projection of the scan.
    pixel_labels : (H, W) integers
        Train id of every pixel, 0 … C − 1; not used where a pixel is empty.
    class_count : int
        C, the number of classes including the unlabelled class 0.
    parameters : KnnParameters
        Neighbourhood; the published one by default.

    Returns
    -------
    (N,) uint8
        Train id of every point; 0 for a point without a pixel.

    Raises
    ------
    LabelError
        If the labels have another shape than the image or are not train ids.
    """
    labels = _checked_labels(image, np.asarray(pixel_labels), class_count)
    half = parameters.window // 2
    width = image.width
    empty = image.channels[0] <= 0
    ranges = _framed(np.where(empty, np.float32(np.inf), image.channels[0]), half, np.inf)
    labels = _framed(np.where(empty, np.uint8(0), labels), half, 0)
    offsets, weights = candidates(parameters, width)
    pixel_of_point = argument(image.pixel_of_point, np.int32)
    point_range = argument(image.point_range, np.float32)
    frame = half * (width + 2 * half) + half
    is_mixed = np.empty(labels.size - 2 * frame, np.bool_)
    refined = np.empty(len(pixel_of_point), np.uint8)
    framed = FramedImage(ranges, labels, is_mixed, width, half)
    rules = VoteRules(offsets, weights, parameters.k, np.float32(parameters.cutoff))

    def mark(pixels: slice) -> None:
        mark_mixed(labels, frame + pixels.start, offsets, is_mixed[pixels])

    def refine(points: slice) -> None:
        refine_points(pixel_of_point[points], point_range[points], framed, rules, refined[points])

    parallel_for_slices(mark, is_mixed.size)
    parallel_for_slices(refine, len(refined))
    return refined


def _framed(image: npt.NDArray[Scalar], half: int, beyond: float) -> npt.NDArray[Scalar]:
    """Return the flat image in a frame of `half` pixels: periodic in azimuth, else `beyond`."""
    wide = np.pad(image, ((0, 0), (half, half)), mode="wrap")
    return np.pad(wide, ((half, half), (0, 0)), constant_values=beyond).reshape(-1)


def _checked_labels(image: RangeImage, labels: npt.NDArray[np.generic], count: int) -> TrainIds:
    """Return labels (H, W) uint8 that fit the image, since the kernels do not check bounds."""
    if not 1 <= count <= 256:
        raise UsageError("knn", f"{count} classes are not possible", "1 to 256")
    size = (image.height, image.width)
    if labels.shape != size:
        raise LabelError("pixel labels", f"have shape {labels.shape}", f"{size}")
    if not np.issubdtype(labels.dtype, np.integer):
        raise LabelError("pixel labels", f"have dtype {labels.dtype}", "integer train ids")
    if labels.min() < 0 or labels.max() >= count:
        problem = f"range from {labels.min()} to {labels.max()}"
        raise LabelError("pixel labels", problem, f"0 to {count - 1}")
    pixels = image.pixel_of_point
    if len(pixels) and (pixels.min() < -1 or pixels.max() >= labels.size):
        problem = f"range from {pixels.min()} to {pixels.max()}"
        raise LabelError("pixels of points", problem, f"-1 to {labels.size - 1}")
    return labels.astype(np.uint8, copy=False)


@compiled
def mark_mixed(labels: TrainIds, first: int, offsets: Int, is_mixed: Mask) -> None:
    """Write whether the window of a pixel holds another label above 0.

    Parameters
    ----------
    labels : (P,) uint8
        Flat train ids of a framed image.
    first : int
        Index of the first pixel in it.
    offsets : (M,) int32
        Flat offsets of the other pixels of the window.
    is_mixed : (K,) bool
        Result for K pixels from the first on.
    """
    size = len(is_mixed)
    for i in range(size):
        is_mixed[i] = False
    centre = labels[first : first + size]
    for offset in offsets:
        other = labels[first + offset : first + offset + size]
        for i in range(size):
            is_mixed[i] |= (other[i] != centre[i]) & (other[i] != 0)


@compiled
def refine_points(
    pixel_of_point: Int, point_range: Float, image: FramedImage, rules: VoteRules, refined: TrainIds
) -> None:
    """Write the label of each point: 0 without a pixel, else of its pixel or of the vote.

    Parameters
    ----------
    pixel_of_point : (N,) int32
        Flat pixel index in the image without a frame; -1 for none.
    point_range : (N,) float32
        Range of each point in metres.
    image : FramedImage
        Ranges and labels of the pixels.
    rules : VoteRules
        Neighbours that vote.
    refined : (N,) uint8
        Result.
    """
    labels = image.labels
    is_mixed = image.is_mixed
    width = image.width
    half = image.half
    frame = half * (width + 2 * half) + half
    chosen = np.empty(BLOCK, np.int32)
    centre = np.full(BLOCK, frame, np.int32)
    centre_range = np.zeros(BLOCK, np.float32)
    voted = np.empty(BLOCK, np.int32)
    size = 0
    for i in range(len(refined)):
        pixel = pixel_of_point[i]
        position = max(pixel, 0)
        position += np.uint32(position) // np.uint32(width) * 2 * half
        refined[i] = labels[position + frame] if pixel >= 0 else 0
        if pixel >= 0 and is_mixed[position]:
            chosen[size] = i
            centre[size] = position + frame
            centre_range[size] = point_range[i]
            size += 1
        if size == BLOCK or (size > 0 and i == len(refined) - 1):
            vote_of_block(centre, centre_range, image, rules, voted)
            for j in range(size):
                refined[chosen[j]] = voted[j]
            size = 0


@compiled
def vote_of_block(
    centre: Int, centre_range: Float, image: FramedImage, rules: VoteRules, voted: Int
) -> None:
    """Write the label of each point of a block by the vote of its neighbours.

    A candidate is one integer, so that one comparison ranks it. From the highest bit, it holds the
    distance (the bits of a float ≥ 0 are in its order), the place in the window and the label.

    Parameters
    ----------
    centre : (BLOCK,) int32
        Index of the pixel of each point in the framed image.
    centre_range : (BLOCK,) float32
        Range of each point in metres.
    image : FramedImage
        Ranges and labels of the pixels.
    rules : VoteRules
        Neighbours that vote.
    voted : (BLOCK,) int32
        Result.
    """
    ranges = image.ranges
    labels = image.labels
    offsets = rules.offsets
    weights = rules.weights
    k = rules.k
    cutoff = rules.cutoff
    distance = np.empty(BLOCK, np.float32)
    distance_bits = distance.view(np.int32)
    label = np.empty(BLOCK, np.int32)
    candidate = np.empty(BLOCK, np.int64)
    nearest = np.empty((k, BLOCK), np.int64)
    for place in range(k):
        for j in range(BLOCK):
            nearest[place, j] = labels[centre[j]] if place == 0 else FARTHEST
    for n in range(len(offsets)):
        offset = offsets[n]
        weight = weights[n]
        for j in range(BLOCK):
            distance[j] = ranges[centre[j] + offset]
            label[j] = labels[centre[j] + offset]
        for j in range(BLOCK):
            distance[j] = abs(distance[j] - centre_range[j]) * weight
            label[j] *= distance[j] <= cutoff
        for j in range(BLOCK):
            candidate[j] = (np.int64(distance_bits[j]) << 32) | (n << 8) | label[j]
        for place in range(1, k):
            keep_nearer(nearest[place], candidate)
    majority(nearest, voted)


@compiled
def keep_nearer(nearest: Candidates, candidate: Candidates) -> None:
    """Put the nearer candidate in a place; the farther becomes the candidate of the next.

    Parameters
    ----------
    nearest : (BLOCK,) int64
        Candidate in this place, by point.
    candidate : (BLOCK,) int64
        Candidate to compare with it.
    """
    for j in range(BLOCK):
        holder = nearest[j]
        challenger = candidate[j]
        nearest[j] = min(holder, challenger)
        candidate[j] = max(holder, challenger)


@compiled
def majority(nearest: Candidates, voted: Int) -> None:
    """Write the most frequent label above 0, the lowest in a tie; 0 without any.

    Parameters
    ----------
    nearest : (k, BLOCK) int64
        Nearest candidates of each point.
    voted : (BLOCK,) int32
        Result.
    """
    voters = np.empty(nearest.shape, np.int32)
    count = np.empty(BLOCK, np.int32)
    for place in range(len(voters)):
        for j in range(BLOCK):
            voters[place, j] = nearest[place, j] & 255
    for j in range(BLOCK):
        voted[j] = 255
    for place in range(len(voters)):
        for j in range(BLOCK):
            count[j] = 0
        for other in range(len(voters)):
            for j in range(BLOCK):
                count[j] += np.int32(voters[other, j] == voters[place, j])
        for j in range(BLOCK):
            score = 256 * count[j] + 255 - voters[place, j] if voters[place, j] > 0 else 255
            voted[j] = max(voted[j], score)
    for j in range(BLOCK):
        voted[j] = 255 - (voted[j] & 255)
