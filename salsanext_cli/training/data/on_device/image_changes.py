# SPDX-License-Identifier: MIT
"""Changes of the range images of a batch: holes, fewer beams, filled gaps, one window of each.

Images have C channels (B, C, H, W) float32, of which the first is the range in metres, 0 in empty
pixels.
"""

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.engines.device_copies import device_numbers
from salsanext_cli.core.geometry.row_gaps import BEYOND, FILLED_ROWS, MAX_GAP
from salsanext_cli.core.records import Double, Mask
from salsanext_cli.training.data.on_device.batch_random import BatchRandom
from salsanext_cli.training.data.other_sensors import (
    CONTINUED,
    EDGE_RATIO,
    HOLE_SHARES,
    MAX_ROWS,
    MAX_RUN,
    MIN_ROWS,
    RANGE_EDGES_M,
)


def hole_cells(ranges: Tensor) -> Tensor:
    """Return the cell of `HOLE_SHARES` of each pixel of ranges (B, H, W), -1 beyond `MAX_RUN`."""
    sides = []
    steps = []
    for sign in (1, -1):
        side = torch.zeros_like(ranges)
        distance = torch.full_like(ranges, MAX_RUN)
        for step in range(MAX_RUN, 0, -1):
            neighbour = ranges.roll(sign * step, dims=2)
            side = torch.where(neighbour > 0, neighbour, side)
            distance = torch.where(neighbour > 0, step, distance)
        sides.append(side)
        steps.append(distance)
    near = torch.minimum(sides[0], sides[1])
    far = torch.maximum(sides[0], sides[1])
    edges = device_numbers(RANGE_EDGES_M, ranges.device)
    # An edge belongs to the bin above it.
    cells = torch.bucketize(near, edges, right=True)
    cells += (far > EDGE_RATIO * near) * HOLE_SHARES.shape[1]
    between = (near > 0) & (steps[0] + steps[1] - 1 <= MAX_RUN)
    return torch.where(between, cells, -1)


def make_holes(images: Tensor, factors: Double, random: BatchRandom) -> Tensor:
    """Return images with holes; the shares are `HOLE_SHARES` times the factor of each, (B,)."""
    ranges = images[:, 0]
    shares = random.put(np.append(HOLE_SHARES, 0.0))[hole_cells(ranges)]
    shares = shares * random.put(factors)[:, None, None]
    chance = random.uniform(*ranges.shape)
    is_first = random.uniform(*ranges.shape) >= CONTINUED
    column = torch.arange(ranges.shape[2], device=images.device)
    source = torch.where(is_first, column, 0).cummax(dim=2).values
    is_lost = chance.gather(2, source) < shares
    return images.masked_fill(is_lost[:, None], 0)


def drawn_rows(count: int, height: int, random: np.random.Generator) -> Mask:
    """Return the rows of fewer beams of images, (count, height) bool: evenly spaced or random."""
    shares = random.uniform(MIN_ROWS, MAX_ROWS, count)
    rows = np.maximum(1, np.rint(height * shares)).astype(np.intp)[:, None]
    ranks = random.random((count, height)).argsort(axis=1)
    # Row i is one of n even ones if a multiple of H / n, from an offset, lies in [i, i + 1).
    border = np.arange(height + 1) * rows / height - random.random((count, 1))
    evenly = np.diff(np.ceil(border), axis=1) > 0
    return np.where(random.random((count, 1)) < 0.5, evenly, ranks < rows)


def row_gap_shares(ranges: Tensor) -> Tensor:
    """Return the share of gaps between the rows of ranges (B, H, W), (B,); NaN without points."""
    is_full = ranges > 0
    height = ranges.shape[1]
    row = torch.arange(height, device=ranges.device)[:, None]
    above = torch.where(is_full, row, -BEYOND).cummax(dim=1).values
    below = torch.where(is_full, row, height + BEYOND).flip(1).cummin(dim=1).values.flip(1)
    gaps = (~is_full & (below - above <= MAX_GAP + 1)).sum(dim=(1, 2))
    return gaps / (gaps + is_full.sum(dim=(1, 2)))


def fill_rows(images: Tensor, is_filled: Tensor) -> Tensor:
    """Return images in which empty pixels hold the next point below, where (B,) is true."""
    filled = images
    for rows in range(1, FILLED_ROWS + 1):
        upper = filled[:, :, :-rows]
        is_empty = (upper[:, :1] <= 0) & is_filled[:, None, None, None]
        moved = torch.where(is_empty, images[:, :, rows:], upper)
        filled = torch.cat([moved, filled[:, :, -rows:]], dim=2)
    return filled


def window_columns(
    truth: Tensor, scored: Mask, width: int, on_class: float, random: BatchRandom
) -> Tensor:
    """Choose the columns of a window of each image, which may cross the edge of the image.

    With probability `on_class` it contains a pixel of a class drawn evenly from the scored ones.

    Parameters
    ----------
    truth : (B, H, W) uint8
        Targets of the pixels.
    scored : (T,) bool
        Targets that count.
    width : int
        Number of columns of the window; 0, or at least W, takes all columns.
    on_class : float
        Chance of a window that contains the drawn class.
    random : BatchRandom
        Random numbers of the batch.

    Returns
    -------
    (B, width) int64
    """
    count, _, whole = truth.shape
    if width == 0 or width >= whole:
        return torch.arange(whole, device=truth.device).expand(count, whole)
    start = random.put(random.host.integers(whole, size=count), torch.int64)
    if on_class:
        place = random.put(random.host.integers(width, size=count), torch.int64)
        contains_class = random.put(random.happens(on_class, count), torch.bool)
        flat = truth.flatten(1).long()
        # All pixels of a class write the same value: none waits for another, as in a count.
        is_present = torch.zeros(count, len(scored), dtype=torch.bool, device=truth.device)
        is_present = is_present.scatter_(1, flat, True) & random.put(scored, torch.bool)
        # The largest of random numbers is drawn evenly.
        target = (random.uniform(*is_present.shape) + is_present).argmax(dim=1, keepdim=True)
        pixel = (random.uniform(*flat.shape) + (flat == target)).argmax(dim=1)
        on_target = pixel % whole - place
        start = torch.where(contains_class & is_present.any(dim=1), on_target, start)
    columns = start[:, None] + torch.arange(width, device=truth.device)
    return columns % whole


def columns_of(images: Tensor, columns: Tensor) -> Tensor:
    """Return the columns (B, K) of images (B, C, H, W)."""
    index = columns[:, None, None].expand(*images.shape[:3], columns.shape[1])
    return images.gather(3, index)
