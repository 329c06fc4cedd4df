# SPDX-License-Identifier: MIT
"""kNN refinement on a torch device: the same candidates, keys and votes as the compiled one."""

import numpy as np
import torch

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.records import Float, Int

CHUNK_POINTS = 1 << 17
"""Number of points refined at once, which bounds the memory of their windows."""


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
    device: str,
) -> TrainIds:
    """Return the label of every point; see `knn.knn_refine`."""
    framed_ranges = torch.tensor(ranges, device=device)
    framed_labels = torch.tensor(labels, device=device)
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
        candidates = torch.where(distance <= cutoff, framed_labels[windows], 0)
        own = framed_labels[centre]
        voted = majority(nearest_labels(own, distance, candidates, k))
        refined[part] = torch.where(pixels[part] >= 0, voted, 0)
    result: TrainIds = refined.cpu().numpy()
    return result


def nearest_labels(
    own: torch.Tensor, distance: torch.Tensor, labels: torch.Tensor, k: int
) -> torch.Tensor:
    """Return labels of the point and its nearest candidates, (N, ≤ k) int64, ranked as in `knn`."""
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
