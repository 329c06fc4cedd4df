# SPDX-License-Identifier: MIT
"""Labels of points by their nearest neighbours in range, equal to those of `geometry.knn`."""

from dataclasses import dataclass
from functools import lru_cache

import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.core.geometry.knn import candidates
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.on_device.projection import RangeImages

LABEL_BITS = 8  # Lowest bits of a candidate: its label
PLACE_BITS = 24  # Next bits: its place in the window; the bits of the distance are above
NO_LABEL = 256  # Above every label
CHUNK_CANDIDATES = 1 << 24  # Most candidates at once, which bounds the memory of large windows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FramedImages:
    """Range images in frames of half a window: periodic in azimuth, empty above and below.

    Attributes
    ----------
    ranges : (B, H + 2 h, W + 2 h) float32
        Ranges in metres; infinite in empty pixels.
    labels : (B, H + 2 h, W + 2 h) int64
        Train ids; 0 in empty pixels.
    """

    ranges: Tensor
    labels: Tensor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Window:
    """Candidates around a pixel.

    Attributes
    ----------
    offsets : (M,) int64
        Flat offsets in the framed image.
    weights : (M,) float32
        Factors of their distances.
    """

    offsets: Tensor
    weights: Tensor


def knn_refine(images: RangeImages, pixel_labels: Tensor, parameters: KnnParameters) -> Tensor:
    """Label every point by a vote of its nearest neighbours in its range image.

    Parameters
    ----------
    images : RangeImages
        Projections of B scans with P points in all.
    pixel_labels : (B, H, W) uint8
        Train ids of the pixels; not used where a pixel is empty.
    parameters : KnnParameters
        Neighbourhood.

    Returns
    -------
    (P,) uint8
        Train id of every point; 0 for a point without a pixel.
    """
    half = parameters.window // 2
    height, width = pixel_labels.shape[1:]
    occupied = images.occupied
    labels = pixel_labels.long().where(occupied, 0)
    ranges = images.channels[:, 0].where(occupied, torch.inf)
    framed = FramedImages(ranges=_framed(ranges, half, torch.inf), labels=_framed(labels, half, 0))
    pixel = images.pixel_of_point
    has_pixel = pixel >= 0
    label_of_pixel = labels.reshape(-1)[pixel.clamp(min=0)]
    refined = label_of_pixel.where(has_pixel, 0)
    is_mixed = _mixed(framed, labels, parameters.window).reshape(-1)
    voting = torch.nonzero(has_pixel & is_mixed[pixel.clamp(min=0)])[:, 0]
    row = torch.div(pixel, width, rounding_mode="floor")
    scan = torch.div(row, height, rounding_mode="floor")
    framed_row = row + scan * (2 * half) + half
    centre = framed_row * (width + 2 * half) + pixel % width + half
    window = window_of(parameters, width, str(pixel.device))
    size = max(1, CHUNK_CANDIDATES // max(len(window.offsets), parameters.k**2))
    for points in torch.split(voting, size):
        voters = _voters(framed, centre[points], images.point_range[points], window, parameters)
        refined[points] = majority(voters)
    return refined.to(torch.uint8)


@lru_cache(maxsize=8)
def window_of(parameters: KnnParameters, width: int, device: str) -> Window:
    """Return the candidates of another pixel than that of the point, on a device."""
    offsets, weights = candidates(parameters, width)
    return Window(
        offsets=torch.from_numpy(offsets).long().to(device),
        weights=torch.from_numpy(weights).to(device),
    )


def _framed(images: Tensor, half: int, beyond: float) -> Tensor:
    """Return images (B, H, W) in a frame: periodic in azimuth, else `beyond`."""
    width = images.shape[2]
    columns = torch.arange(-half, width + half, device=images.device) % width
    return F.pad(images[:, :, columns], (0, 0, half, half), value=beyond)


def _mixed(framed: FramedImages, labels: Tensor, window: int) -> Tensor:
    """Return whether the window of each pixel holds another label above 0.

    Parameters
    ----------
    framed : FramedImages
        B range images.
    labels : (B, H, W) int64
        The labels without their frame.
    window : int
        Side of the window in pixels.

    Returns
    -------
    (B, H, W) bool
    """
    around = framed.labels.float()
    highest = F.max_pool2d(around, window, stride=1)
    inverted = (NO_LABEL - around).where(around > 0, 0)
    lowest = NO_LABEL - F.max_pool2d(inverted, window, stride=1)
    other_above = (highest > 0) & (highest != labels)
    other_below = (lowest < NO_LABEL) & (lowest != labels)
    return other_above | other_below


def _voters(
    framed: FramedImages,
    centre: Tensor,
    centre_range: Tensor,
    window: Window,
    parameters: KnnParameters,
) -> Tensor:
    """Return the labels of the nearest neighbours of points, 0 for those that do not vote.

    A candidate is one integer, as in the kernel: distance, place in the window, label.

    Parameters
    ----------
    framed : FramedImages
        Ranges and labels of the pixels.
    centre : (N,) int64
        Flat index of the pixel of each point in the framed images.
    centre_range : (N,) float32
        Range of each point in metres.
    window : Window
        M candidates.
    parameters : KnnParameters
        Number of neighbours and cutoff.

    Returns
    -------
    (N, K) int64
        The first is the label of the pixel of the point.
    """
    label_of_pixel = framed.labels.reshape(-1)[centre, None]
    others = min(parameters.k - 1, len(window.offsets))
    if others == 0:
        return label_of_pixel
    neighbours = centre[:, None] + window.offsets
    ranges = framed.ranges.reshape(-1)[neighbours]
    distance = (ranges - centre_range[:, None]).abs() * window.weights
    labels = framed.labels.reshape(-1)[neighbours].where(distance <= parameters.cutoff, 0)
    place = torch.arange(len(window.offsets), device=centre.device) << LABEL_BITS
    bits = distance.view(torch.int32).long() << (LABEL_BITS + PLACE_BITS)
    nearest = (bits | place | labels).topk(others, dim=1, largest=False, sorted=False).values
    return torch.cat([label_of_pixel, nearest & ((1 << LABEL_BITS) - 1)], dim=1)


def majority(voters: Tensor) -> Tensor:
    """Return the most frequent label above 0 of each row (N, K) int64, the lowest in a tie.

    It is 0 for rows without any.
    """
    votes = (voters[:, :, None] == voters[:, None, :]).sum(dim=2)
    score = (votes * NO_LABEL + (NO_LABEL - 1 - voters)).where(voters > 0, NO_LABEL - 1)
    return NO_LABEL - 1 - score.amax(dim=1) % NO_LABEL
