# SPDX-License-Identifier: MIT
"""Fusion of the softmax of scans that see the same locations, in a window along the drive."""

import logging
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.fusion.visibility import nearest_ranges, seen_by
from salsanext_cli.core.fusion.votes import (
    MAX_CELLS,
    SCALE,
    VOXEL_SIZES_M,
    OtherVotes,
    Tally,
    VoxelVotes,
    tally,
)
from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.records import Double, Float, Mask

MOVABLE_SHARE = 0.2  # Least share of votes for movable classes that needs a look by other scans
SCAN_M = 500.0  # Least reach of the voxels around the farthest scan of a drive
log = logging.getLogger(__name__)
ReadScan = Callable[[int], tuple[Float, Float]]
"""Function from the number of a scan in its drive to its points (N, 3) and softmax (N, C)."""


def warn_without_movable_classes(space: LabelSpace) -> None:
    """Log a warning for a label space that does not state its movable classes."""
    if space.movable_ids is None and not space.movable.any():
        problem = f"label space {space.name} does not state which classes are movable"
        warn_once(log, f"{problem}: moving objects are fused as if they stood still")


class PlacedScan(NamedTuple):
    """Scan in the frame of the drive."""

    points: Double  # (N, 3)
    votes: list[VoxelVotes]  # Votes for both sizes of voxels
    ranges: Float  # As of `nearest_ranges`


class FusionWindow:
    """Votes of the scans around one of a drive, which are read once while the window moves.

    Parameters
    ----------
    drive : Drive
        Poses of the scans.
    read : callable
        Returns points (N, 3) and softmax (N, C) of the scan with a number.
    reach : FusionReach
        Scans that vote.
    movable : (C,) bool
        Whether each class is movable.
    """

    def __init__(self, drive: Drive, read: ReadScan, reach: FusionReach, movable: Mask) -> None:
        self.poses = drive.poses
        self.parts = drive.parts
        self.read = read
        self.reach = reach
        self.places = drive.poses[:, :3, 3] - drive.origins[drive.parts]
        self.seen: dict[int, PlacedScan | SalsanextError] = {}
        self.movable = movable
        self.all_classes = np.ones(len(movable), np.uint8)
        self.fixed_classes = (~movable).astype(np.uint8)

    def tally(self, index: int) -> Tally:
        """Return the votes of the scans of the window for the points of a scan."""
        scan, others = self._around(index)
        tallies = []
        for size, votes in enumerate(scan.votes):
            other_votes = [
                self._other_votes(other.votes[size], abs(i - index)) for i, other in others.items()
            ]
            tallies.append(tally(votes, other_votes, self._stands(votes, scan, others)))
        mean = np.mean([sums.probabilities for sums in tallies], axis=0)
        return Tally(probabilities=mean, scan_counts=tallies[-1].scan_counts)

    def _other_votes(self, votes: VoxelVotes, distance: int) -> OtherVotes:
        """Return the votes of a scan at a distance in scans, which decides what it counts for."""
        is_near = distance <= self.reach.movable_reach
        classes = self.all_classes if is_near else self.fixed_classes
        return OtherVotes(votes.keys, votes.votes, classes)

    def _around(self, index: int) -> tuple[PlacedScan, dict[int, PlacedScan]]:
        """Return a scan, and the readable others in reach in its part."""
        reach = self.reach.reach
        near = range(max(0, index - reach), min(len(self.parts), index + reach + 1))
        members = [i for i in near if self.parts[i] == self.parts[index]]
        # Scans out of reach are freed before others are read: the next chunk may lie far away.
        self.seen = {i: self.seen[i] for i in members if i in self.seen}
        self.seen = {i: self.seen[i] if i in self.seen else self._placed(i) for i in members}
        error = self.seen[index]
        if isinstance(error, SalsanextError):
            raise error
        readable = {i: s for i, s in self.seen.items() if not isinstance(s, SalsanextError)}
        return readable.pop(index), readable

    def _stands(
        self, votes: VoxelVotes, scan: PlacedScan, others: Mapping[int, PlacedScan]
    ) -> npt.NDArray[np.uint8]:
        """Return the mask (V,) of voxels of movable objects that fewer scans see through than see.

        A voxel counts as movable from `MOVABLE_SHARE` of the votes.
        """
        stands = np.zeros(len(votes.keys), np.uint8)
        movable = votes.votes[:, self.movable].sum(axis=1, dtype=np.uint32)
        voxels = np.flatnonzero(movable > MOVABLE_SHARE * SCALE)
        scans = [(self.poses[i, :3, :3], self.places[i], s.ranges) for i, s in others.items()]
        standing, through = seen_by(scan.points[votes.points[voxels]], scans)
        stands[voxels] = through < standing
        return stands

    def _placed(self, index: int) -> PlacedScan | SalsanextError:
        place = self.places[index]
        most = VOXEL_SIZES_M[0] * MAX_CELLS - SCAN_M
        try:
            farthest = np.abs(place).max()
            if not farthest <= most:
                subject = f"pose of scan {index}"
                expected = f"at most {most / 1000:.1f} km"
                away = f"is {farthest / 1000:.1f} km from the first scan of its part of the drive"
                raise UsageError(subject, away, expected, "fuse shorter drives")
            points, softmax = self.read(index)
        except SalsanextError as error:
            return error
        with np.errstate(invalid="ignore"):  # Infinite points become NaN.
            placed = points.astype(np.float64) @ self.poses[index, :3, :3].T + place
        votes = [VoxelVotes.from_scan(placed, softmax, size) for size in VOXEL_SIZES_M]
        return PlacedScan(placed, votes, nearest_ranges(points))
