# SPDX-License-Identifier: MIT
"""Votes of the scans of a drive for the classes of the locations that they see.

Space is cut into voxels of two sizes. In each voxel a scan has one vote: the mean softmax of its
points there. So a near scan with a thousand points weighs no more than a far one with a single
point.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.compiled import argument, compiled, parallel_for_slices
from salsanext_cli.core.records import Double, Float

VOXEL_SIZES_M = (0.3, 0.6)  # Edges of the voxels, whose shares of the votes are averaged
KEY_BITS = 21  # Bits of a voxel index along each axis: 2²¹ voxels of 0.3 m are 629 km
MAX_CELLS = 1 << (KEY_BITS - 1)  # Voxels farther from the origin, along any axis, have no keys
SCALE = 65535  # Scale of a probability in a vote, which is a uint16

Keys = npt.NDArray[np.int64]
Votes = npt.NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class VoxelVotes:
    """Votes of one scan in the V voxels of one size that it sees."""

    keys: Keys  # (V,) ascending
    votes: Votes  # (V, C): mean softmax × `SCALE`
    voxel_of_point: npt.NDArray[np.int32]  # (N,): index in `keys`, -1 for a point without a vote
    points: npt.NDArray[np.intp]  # (V,): index of a point in each voxel

    @classmethod
    def of_scan(cls, points: Double, probabilities: Float, size: float) -> Self:
        """Return the votes of labelled points of a scan in voxels with an edge of `size` metres.

        Points (N, 3) are float64 metres in the frame of the drive, probabilities (N, C) float32.
        """
        keys = keys_of(points, size)
        rows = np.flatnonzero((probabilities[:, 0] < 1) & (keys >= 0))
        rows = rows[np.argsort(keys[rows], kind="stable")]
        keys = keys[rows]
        borders = np.append(np.flatnonzero(np.diff(keys, prepend=-1)), len(keys))
        first = borders[:-1]
        voxel_of_point = np.full(len(points), -1, np.int32)
        voxel_of_point[rows] = np.repeat(np.arange(len(first)), np.diff(borders))
        votes = np.empty((len(first), probabilities.shape[1]), np.uint16)
        _mean_of_voxels(argument(probabilities, np.float32), rows, borders, votes)
        return cls(keys[first], votes, voxel_of_point, rows[first])


@dataclass(frozen=True, slots=True)
class Tally:
    """Votes of all scans for the points of one scan."""

    probabilities: Float  # (N, C) float32: mean of the votes, 0 without a vote
    views: npt.NDArray[np.uint16]  # (N,): number of scans that see the location, 0 without a vote

    def fused(self, labels: TrainIds) -> TrainIds:
        """Return the labels (N,) by all scans that see the points; unlabelled points stay so."""
        fused = (self.probabilities[:, 1:].argmax(axis=1) + 1).astype(np.uint8)
        return np.where((self.views > 1) & (labels > 0), fused, labels)

    def disagreement(self, labels: TrainIds) -> Float:
        """Return the share of votes against each label, (N,) float32; NaN without any vote."""
        share = 1 - np.take_along_axis(self.probabilities, labels[:, None].astype(np.intp), 1)[:, 0]
        return np.where((self.views > 0) & (labels > 0), share, np.nan).astype(np.float32)


def keys_of(points: Double, size: float) -> Keys:
    """Return the key (N,) int64 of the voxel of a size in metres around each point (N, 3).

    The key is -1 if the point is NaN, infinite, or `MAX_CELLS` voxels or more from the origin.
    """
    cells = np.floor(points / size)
    inside = (np.abs(cells) < MAX_CELLS).all(axis=1)
    x, y, z = np.where(inside, cells.T, 0).astype(np.int64) + MAX_CELLS
    return np.where(inside, (x << (2 * KEY_BITS)) | (y << KEY_BITS) | z, -1)


@compiled
def _mean_of_voxels(probabilities: Float, rows: Keys, borders: Keys, votes: Votes) -> None:
    """Write the mean softmax of the points ``rows[borders[v]:borders[v + 1]]`` of each voxel."""
    classes = probabilities.shape[1]
    total = np.empty(classes, np.float32)
    for voxel in range(len(borders) - 1):
        total[:] = 0
        for place in range(borders[voxel], borders[voxel + 1]):
            for c in range(classes):
                total[c] += probabilities[rows[place], c]
        count = borders[voxel + 1] - borders[voxel]
        for c in range(classes):
            votes[voxel, c] = np.uint16(total[c] / count * SCALE + 0.5)


def tally(
    scan: VoxelVotes,
    others: Iterable[tuple[VoxelVotes, npt.NDArray[np.uint8]]],
    stands: npt.NDArray[np.uint8],
) -> Tally:
    """Add up the votes of a scan and of others for its points.

    A class has the mean vote of the scans that count for it; then the classes are scaled to add up
    to 1. Each of the others has a mask (C,) of the classes that it counts for. In the voxels of
    `stands` (V,), it counts for all of them.
    """
    total = scan.votes.astype(np.uint32)
    counts = np.ones(total.shape, np.uint16)
    seen = np.ones(len(scan.keys), np.uint16)
    for other, counted in others:

        def add(
            part: slice, other: VoxelVotes = other, counted: npt.NDArray[np.uint8] = counted
        ) -> None:
            sums = stands[part], total[part], counts[part], seen[part]
            _add(scan.keys[part], other.keys, other.votes, counted, *sums)

        parallel_for_slices(add, len(scan.keys))
    means = total / counts
    # The last row belongs to points without a vote, whose voxel is -1.
    shares = np.zeros((len(total) + 1, total.shape[1]), np.float32)
    shares[:-1] = means / np.maximum(means.sum(axis=1, keepdims=True), 1)
    views = np.append(seen, np.uint16(0))
    return Tally(shares[scan.voxel_of_point], views[scan.voxel_of_point])


@compiled
def _add(
    voxels: Keys,
    keys: Keys,
    votes: Votes,
    counted: npt.NDArray[np.uint8],
    stands: npt.NDArray[np.uint8],
    total: npt.NDArray[np.uint32],
    counts: npt.NDArray[np.uint16],
    seen: npt.NDArray[np.uint16],
) -> None:
    """Add the votes of another scan in the voxels that both see; both keys ascend."""
    if len(voxels) == 0:
        return
    there = np.searchsorted(keys, voxels[0])
    for here in range(len(voxels)):
        while there < len(keys) and keys[there] < voxels[here]:
            there += 1
        if there == len(keys):
            return
        if keys[there] == voxels[here]:
            seen[here] += 1
            for c in range(total.shape[1]):
                counts_here = counted[c] | stands[here]
                total[here, c] += votes[there, c] * counts_here
                counts[here, c] += counts_here
