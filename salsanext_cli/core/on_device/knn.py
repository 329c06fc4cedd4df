# SPDX-License-Identifier: MIT
"""Labels of points by their nearest neighbours in range, equal to those of `geometry.knn`."""

from dataclasses import dataclass
from functools import lru_cache

import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.geometry.knn import candidates
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.on_device.projection import RangeImages

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
    centre = _places_in_frame(images.pixel_of_point.clamp(min=0), height, width, half)
    window = window_of(parameters, width, str(centre.device))
    size = max(1, CHUNK_CANDIDATES // max(len(window.offsets), parameters.k**2))
    chunks = zip(torch.split(centre, size), torch.split(images.point_range, size), strict=True)
    refined = [
        majority(_voters(framed, places, ranges, window, parameters)) for places, ranges in chunks
    ]
    has_pixel = images.pixel_of_point >= 0
    return torch.cat(refined).where(has_pixel, 0).to(torch.uint8)


def _places_in_frame(pixels: Tensor, height: int, width: int, half: int) -> Tensor:
    """Return the flat indices (N,) in framed images of pixels (N,) of images of a size."""
    row = torch.div(pixels, width, rounding_mode="floor")
    scan = torch.div(row, height, rounding_mode="floor")
    framed_row = row + scan * (2 * half) + half
    return framed_row * (width + 2 * half) + pixels % width + half


@lru_cache(maxsize=8)
def window_of(parameters: KnnParameters, width: int, device: str) -> Window:
    """Return the candidates of another pixel than that of the point, on a device."""
    offsets, weights = candidates(parameters, width)
    return Window(
        offsets=device_numbers(offsets, device, torch.int64),
        weights=device_numbers(weights, device),
    )


def _framed(images: Tensor, half: int, beyond: float) -> Tensor:
    """Return images (B, H, W) in a frame: periodic in azimuth, else `beyond`."""
    width = images.shape[2]
    columns = torch.arange(-half, width + half, device=images.device) % width
    return F.pad(images[:, :, columns], (0, 0, half, half), value=beyond)


def _voters(
    framed: FramedImages,
    centre: Tensor,
    centre_range: Tensor,
    window: Window,
    parameters: KnnParameters,
) -> Tensor:
    """Return the labels of the nearest neighbours of points, 0 for those that do not vote.

    Few rounds that each take the nearest of the rest, the first in a tie, are faster on a GPU than
    sorting.

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
    ranges = framed.ranges.reshape(-1)[centre[:, None] + window.offsets]
    distance = (ranges - centre_range[:, None]).abs() * window.weights
    voters = [label_of_pixel]
    for _ in range(others):
        nearest, place = distance.min(dim=1, keepdim=True)
        label = framed.labels.reshape(-1)[centre[:, None] + window.offsets[place]]
        # Where all others are infinite, one that was taken comes again.
        votes = (nearest <= parameters.cutoff) & nearest.isfinite()
        voters.append(label.where(votes, 0))
        distance.scatter_(1, place, torch.inf)
    return torch.cat(voters, dim=1)


def majority(voters: Tensor) -> Tensor:
    """Return the most frequent label above 0 of each row (N, K) int64, the lowest in a tie.

    It is 0 for rows without any.
    """
    votes = (voters[:, :, None] == voters[:, None, :]).sum(dim=2)
    score = (votes * NO_LABEL + (NO_LABEL - 1 - voters)).where(voters > 0, NO_LABEL - 1)
    return NO_LABEL - 1 - score.amax(dim=1) % NO_LABEL
