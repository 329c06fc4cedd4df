# SPDX-License-Identifier: MIT
"""kNN refinement on a torch device: the same candidates, keys and votes as the compiled one."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F

from salsanext_cli.classes import TrainIds
from salsanext_cli.geometry.knn_parameters import KnnParameters
from salsanext_cli.records import Float, Int

CHUNK_POINTS = 1 << 17
"""Number of points refined at once, which bounds the memory of their windows."""


def refine(
    ranges: Float,
    labels: TrainIds,
    pixel_of_point: Int,
    point_range: Float,
    parameters: KnnParameters,
    device: str,
) -> TrainIds:
    """Return the label of every point; see `geometry.knn.knn_refine`."""
    half, width = parameters.window // 2, ranges.shape[1]
    range_of_pixel = torch.tensor(ranges, device=device)
    empty = range_of_pixel <= 0
    framed_ranges = framed(torch.where(empty, torch.inf, range_of_pixel), half, torch.inf)
    framed_labels = framed(torch.where(empty, 0, torch.tensor(labels, device=device)), half, 0)
    offsets, weights = parameters.candidates(width)
    neighbours = torch.tensor(offsets.astype(np.int64), device=device)
    factors = torch.tensor(weights, device=device)
    pixels = torch.tensor(pixel_of_point, device=device)
    own_range = torch.tensor(point_range, device=device)
    refined = torch.zeros_like(pixels, dtype=torch.uint8)
    for start in range(0, len(refined), CHUNK_POINTS):
        part = slice(start, start + CHUNK_POINTS)
        pixel = pixels[part].clamp(min=0).long()
        centre = pixel + (pixel // width + half) * 2 * half + half * width + half
        windows = centre[:, None] + neighbours
        distance = (framed_ranges[windows] - own_range[part, None]).abs() * factors
        candidates = torch.where(distance <= parameters.cutoff, framed_labels[windows], 0)
        own = framed_labels[centre]
        voted = majority(nearest_labels(own, distance, candidates, parameters.k))
        refined[part] = torch.where(pixels[part] >= 0, voted, 0)
    result: TrainIds = refined.cpu().numpy()
    return result


def framed(image: torch.Tensor, half: int, beyond: float) -> torch.Tensor:
    """Return the flattened image with a frame of `half` pixels, periodic in azimuth."""
    width = image.shape[1]
    columns = torch.arange(-half, width + half, device=image.device) % width
    return F.pad(image[:, columns], (0, 0, half, half), value=beyond).reshape(-1)


def nearest_labels(
    own: torch.Tensor, distance: torch.Tensor, labels: torch.Tensor, k: int
) -> torch.Tensor:
    """Return the labels of the point itself and its nearest candidates, (N, ≤ k) int64.

    A candidate is one integer: from the highest bit its distance (the bits of a float ≥ 0 are in
    its order), its place in the window, its label; so no two are equally near.
    """
    place = torch.arange(distance.shape[1], device=distance.device) << 8
    keys = (distance.view(torch.int32).long() << 32) | place | labels.long()
    others = min(k - 1, keys.shape[1])
    nearest = keys.topk(others, dim=1, largest=False, sorted=False).values & 255
    return torch.cat([own[:, None].long(), nearest], dim=1)


def majority(voters: torch.Tensor) -> torch.Tensor:
    """Return the most frequent label above 0, the lowest of equally frequent ones, else 0."""
    count = torch.zeros_like(voters)
    for voter in voters.unbind(1):
        count += voters == voter[:, None]
    score = torch.where(voters > 0, 256 * count + 255 - voters, 255).amax(1)
    return (255 - (score & 255)).to(torch.uint8)
