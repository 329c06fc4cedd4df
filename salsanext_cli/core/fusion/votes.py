# SPDX-License-Identifier: MIT
"""Votes of the scans of a drive for the classes of the locations that they see.

Space is cut into voxels of two sizes. In each voxel a scan has one vote: the mean softmax of its
points there. So a near scan with a thousand points weighs no more than a far one with a single
point.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, Self

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
    def from_scan(cls, points: Double, probabilities: Float, size: float) -> Self:
        """Return the votes of the labelled points of a scan.

        Parameters
        ----------
        points : (N, 3) float64
            Coordinates in the frame of the drive, metres.
        probabilities : (N, C) float32
            Softmax of each point; 1 for class 0 if the point has no label.
        size : float
            Edge of the voxels in metres.

        Returns
        -------
        VoxelVotes
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """Votes of all scans for the points of one scan."""

    probabilities: Float  # (N, C) float32: mean of the votes, 0 without a vote
    # (N,): number of scans that see the location, 0 without a vote
    scan_counts: npt.NDArray[np.uint16]

    def fused(self, labels: TrainIds) -> TrainIds:
        """Return the labels (N,) by all scans that see the points; unlabelled points stay so."""
        fused = (self.probabilities[:, 1:].argmax(axis=1) + 1).astype(np.uint8)
        return np.where((self.scan_counts > 1) & (labels > 0), fused, labels)

    def disagreement(self, labels: TrainIds) -> Float:
        """Return the share of votes against each label, (N,) float32; NaN without any vote."""
        share = 1 - np.take_along_axis(self.probabilities, labels[:, None].astype(np.intp), 1)[:, 0]
        return np.where((self.scan_counts > 0) & (labels > 0), share, np.nan).astype(np.float32)


def keys_of(points: Double, size: float) -> Keys:
    """Return the key of the voxel around each point.

    Parameters
    ----------
    points : (N, 3) float64
        Coordinates in metres.
    size : float
        Edge of the voxels in metres.

    Returns
    -------
    (N,) int64
        Key; -1 for a point that is NaN, infinite, or `MAX_CELLS` voxels or more from the origin.
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


class OtherVotes(NamedTuple):
    """Votes of another scan, as the kernel takes them.

    Attributes
    ----------
    keys : (U,) int64
        Keys of the voxels that the other scan sees, ascending.
    votes : (U, C) uint16
        Mean softmax × `SCALE` in each.
    counts_for : (C,) uint8
        1 for the classes that the other scan counts for, else 0.
    """

    keys: Keys
    votes: Votes
    counts_for: npt.NDArray[np.uint8]


class VoteSums(NamedTuple):
    """Running sums in the V voxels of a scan, as the kernel takes them.

    Attributes
    ----------
    stands : (V,) uint8
        1 where an object stands still, so that the other scans count for all classes.
    total : (V, C) uint32
        Sums of the votes.
    counts : (V, C) uint16
        Number of scans that count for each class.
    views : (V,) uint16
        Number of scans that see the voxel.
    """

    stands: npt.NDArray[np.uint8]
    total: npt.NDArray[np.uint32]
    counts: npt.NDArray[np.uint16]
    views: npt.NDArray[np.uint16]


def tally(scan: VoxelVotes, others: Iterable[OtherVotes], stands: npt.NDArray[np.uint8]) -> Tally:
    """Add up the votes of a scan and of others for its points.

    A class has the mean vote of the scans that count for it; then the classes are scaled to add up
    to 1.

    Parameters
    ----------
    scan : VoxelVotes
        Votes of the scan in V voxels.
    others : iterable of OtherVotes
        Votes of the other scans in voxels of the same size.
    stands : (V,) uint8
        1 for voxels in which the others count for all classes.

    Returns
    -------
    Tally
    """
    total = scan.votes.astype(np.uint32)
    counts = np.ones(total.shape, np.uint16)
    seen = np.ones(len(scan.keys), np.uint16)
    for other in others:

        def add(voxels: slice, other: OtherVotes = other) -> None:
            sums = VoteSums(stands[voxels], total[voxels], counts[voxels], seen[voxels])
            _add(scan.keys[voxels], other, sums)

        parallel_for_slices(add, len(scan.keys))
    means = total / counts
    # The last row belongs to points without a vote, whose voxel is -1.
    shares = np.zeros((len(total) + 1, total.shape[1]), np.float32)
    shares[:-1] = means / np.maximum(means.sum(axis=1, keepdims=True), 1)
    views = np.append(seen, np.uint16(0))
    return Tally(probabilities=shares[scan.voxel_of_point], scan_counts=views[scan.voxel_of_point])


@compiled
def _add(voxels: Keys, other: OtherVotes, sums: VoteSums) -> None:
    """Add the votes of another scan in the voxels (V,) that both see; both keys ascend."""
    if len(voxels) == 0:
        return
    keys = other.keys
    votes = other.votes
    counts_for = other.counts_for
    stands = sums.stands
    total = sums.total
    counts = sums.counts
    views = sums.views
    other_place = np.searchsorted(keys, voxels[0])
    for place in range(len(voxels)):
        while other_place < len(keys) and keys[other_place] < voxels[place]:
            other_place += 1
        if other_place == len(keys):
            return
        if keys[other_place] == voxels[place]:
            views[place] += 1
            for c in range(total.shape[1]):
                counted = counts_for[c] | stands[place]
                total[place, c] += votes[other_place, c] * counted
                counts[place, c] += counted
