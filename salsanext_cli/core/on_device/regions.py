# SPDX-License-Identifier: MIT
"""Regions of the range images of a batch, as `uncertainty.error_features` joins those of one."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from salsanext_cli.core.uncertainty.error_features import NEIGHBOURS_OF_REGION

EMPTY = -1  # Class of an empty pixel
FIXED_POINT = 2.0**40  # Unit of sums of integers, whose order changes no bit
ROUNDS = 14  # Rounds in which regions are joined; those of twelve real scans took 8 to 11


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Regions:
    """Regions of B range images with n = B · H · W pixels, joined in a number of rounds.

    Attributes
    ----------
    lowest : (n,) int64
        Flat index of the lowest pixel of the region of each pixel; an empty one is alone.
    is_whole : (B,) bool
        Whether the last round joined no more pixels of an image, so that its regions are whole.
    """

    lowest: Tensor
    is_whole: Tensor

    @classmethod
    def from_classes(cls, classes: Tensor, rounds: int) -> Self:
        """Join neighbours of one class, without waiting for the device.

        Parameters
        ----------
        classes : (B, H, W) int64
            Class of each pixel, `EMPTY` where there is none.
        rounds : int
            Number of rounds, at least 1. Each joins regions with their neighbours; how many it
            takes depends on the shapes of the regions.

        Returns
        -------
        Regions
        """
        pairs = torch.cat(list(_neighbours(classes)), dim=1)
        # A GPU has an instruction for the least of 32 bits in memory, and loops for 64.
        lowest = torch.arange(classes.numel(), dtype=torch.int32, device=classes.device)
        before = lowest
        for _ in range(rounds):
            before = lowest
            lowest = _joined(before, pairs)
        is_whole = (before == lowest).view(len(classes), -1).all(dim=1)
        return cls(lowest=lowest.long(), is_whole=is_whole)

    def means(self, values: Tensor) -> Tensor:
        """Return the mean of a value over the region of each pixel, as `mean_of_regions` does.

        Parameters
        ----------
        values : (n,) float32
            Values to average, 0…1.

        Returns
        -------
        (n,) float32
        """
        fixed = (values.double() * FIXED_POINT).round().long()
        totals = torch.zeros_like(fixed).index_add_(0, self.lowest, fixed)
        counts = torch.zeros_like(fixed).index_add_(0, self.lowest, torch.ones_like(fixed))
        return (totals[self.lowest] / (counts[self.lowest] * FIXED_POINT)).float()


def _joined(lowest: Tensor, pairs: Tensor) -> Tensor:
    """Return the lowest pixels (n,) so far, after regions with neighbours (2, M) are joined.

    Pixels are int32, neighbours int64.
    """
    joined = lowest.clone()
    roots = lowest[pairs]
    least = roots.amin(dim=0)
    for root, pixel in zip(roots, pairs, strict=True):
        # What changes nothing goes to its pixel, because all writes to one root would queue.
        target = root.long().where(root > least, pixel)
        joined.scatter_reduce_(0, target, least, "amin")
    return joined[joined.long()]


def _neighbours(classes: Tensor) -> Iterator[Tensor]:
    """Yield pairs (2, M) of flat indices of neighbours of one class; others pair with themselves.

    So their number is known without their values.
    """
    height = classes.shape[1]
    index = torch.arange(classes.numel(), device=classes.device).view(classes.shape)
    for rows, columns in NEIGHBOURS_OF_REGION:
        inside = slice(-rows, None)
        other_classes = classes[:, : height + rows].roll(-columns, dims=2)
        other_index = index[:, : height + rows].roll(-columns, dims=2)
        is_same = (classes[:, inside] == other_classes) & (classes[:, inside] != EMPTY)
        first = index[:, inside]
        yield torch.stack([first.flatten(), other_index.where(is_same, first).flatten()])
