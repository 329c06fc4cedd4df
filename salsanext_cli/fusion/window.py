# SPDX-License-Identifier: MIT
"""Fusion of the softmax of scans that see the same places, in a window along the drive."""

import logging
from collections.abc import Callable, Mapping
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.errors import SalsanextError, UsageError, warn_once
from salsanext_cli.fusion.drive import Drive
from salsanext_cli.fusion.pose_checks import Parts
from salsanext_cli.fusion.poses import Poses
from salsanext_cli.fusion.visibility import nearest_ranges, seen_by
from salsanext_cli.fusion.votes import (
    MAX_CELLS,
    SCALE,
    VOXEL_SIZES_M,
    Tally,
    VoxelVotes,
    tally,
    votes_of_scan,
)
from salsanext_cli.option_fields import FusionReach
from salsanext_cli.records import Float

MOVABLE_SHARE = 0.2  # Share of votes for movable classes from which others are asked
SCAN_M = 500.0  # Least reach of the voxels around the farthest scan of a drive
log = logging.getLogger(__name__)
Content = TypeVar("Content")
ReadScan = Callable[[int], tuple[Float, Float, npt.NDArray[np.bool_]]]
"""Function from the number of a scan in its drive to its points (N, 3), their softmax (N, C)
float32, and which of them vote (N,)."""


def movable_classes(space: LabelSpace) -> npt.NDArray[np.bool_]:
    """Return the mask (C,) of movable classes; warn of a label space that states none."""
    if space.movable_ids is None and not space.movable.any():
        found = f"label space {space.name} does not state which classes are movable"
        warn_once(log, f"{found}: moving objects are fused as if they stood still")
    return space.movable


def in_drive(points: Float, rotation: Poses, place: Poses) -> npt.NDArray[np.float64]:
    """Return points (N, 3) of a scan, turned by (3, 3) and moved by (3,); infinite ones are NaN."""
    with np.errstate(invalid="ignore"):
        return points.astype(np.float64) @ rotation.T + place


def require_near(places: npt.NDArray[np.float64], size: float, subject: object, hint: str) -> None:
    """Refuse places (…, 3) of scans, from the first of their part, whose points have no keys."""
    farthest, most = np.abs(places).max(initial=0), size * MAX_CELLS - SCAN_M
    if not farthest <= most:
        found = f"{farthest / 1000:.1f} km from the first scan of its part of the drive"
        raise UsageError(subject, found, f"at most {most / 1000:.1f} km", hint)


class DriveWindow(Generic[Content]):
    """Content of the scans around one of a drive, each read once while the window moves on."""

    def __init__(self, parts: Parts, reach: int, read: Callable[[int], Content]) -> None:
        self.parts, self.reach, self.read = parts, reach, read
        self.contents: dict[int, Content | SalsanextError] = {}

    def around(self, index: int) -> tuple[Content, dict[int, Content]]:
        """Return the content of a scan, and of the readable others in reach in its part."""
        near = range(max(0, index - self.reach), min(len(self.parts), index + self.reach + 1))
        members = [each for each in near if self.parts[each] == self.parts[index]]
        before = self.contents
        self.contents = {i: before[i] if i in before else self._read(i) for i in members}
        own = self.contents[index]
        if isinstance(own, SalsanextError):
            raise own
        others = {i: each for i, each in self.contents.items() if i != index}
        return own, {i: e for i, e in others.items() if not isinstance(e, SalsanextError)}

    def _read(self, index: int) -> Content | SalsanextError:
        try:
            return self.read(index)
        except SalsanextError as error:
            return error


class PlacedScan(NamedTuple):
    """A scan in the frame of the drive."""

    points: npt.NDArray[np.float64]  # (N, 3)
    views: list[VoxelVotes]  # Of both sizes of voxels
    ranges: Float  # Of the nearest points, by direction


class FusionWindow:
    """Votes of the scans around one of a drive; `movable` (C,): movable classes."""

    def __init__(
        self, drive: Drive, read: ReadScan, reach: FusionReach, movable: npt.NDArray[np.bool_]
    ) -> None:
        self.poses, self.read, self.reach = drive.poses, read, reach
        self.places = drive.poses[:, :3, 3] - drive.origins[drive.parts]
        self.window = DriveWindow(drive.parts, reach.reach, self._seen)
        self.movable = movable
        self.counted = {True: np.ones(len(movable), np.uint8), False: (~movable).astype(np.uint8)}

    def tally(self, index: int) -> Tally:
        """Return what the scans of the window say about the places of a scan's points."""
        own, others = self.window.around(index)
        tallies = []
        for size, view in enumerate(own.views):
            votes = []
            for each, seen in others.items():
                near = abs(each - index) <= self.reach.movable_reach
                votes.append((seen.views[size], self.counted[near]))
            tallies.append(tally(view, votes, self._stands(view, own, others)))
        mean = np.mean([each.probabilities for each in tallies], axis=0)
        return Tally(mean, tallies[-1].views)

    def _stands(
        self, view: VoxelVotes, own: PlacedScan, others: Mapping[int, PlacedScan]
    ) -> npt.NDArray[np.uint8]:
        """Return in which voxels (V,) of movable objects more scans see something than nothing."""
        stands = np.zeros(len(view.keys), np.uint8)
        movable = view.votes[:, self.movable].sum(axis=1, dtype=np.uint32)
        asked = np.flatnonzero(movable > MOVABLE_SHARE * SCALE)
        scans = [(self.poses[i, :3, :3], self.places[i], e.ranges) for i, e in others.items()]
        there, through = seen_by(own.points[view.points[asked]], scans)
        stands[asked] = through < there
        return stands

    def _seen(self, index: int) -> PlacedScan:
        place = self.places[index]
        require_near(place, VOXEL_SIZES_M[0], f"pose of scan {index}", "fuse shorter drives")
        points, softmax, voting = self.read(index)
        placed = in_drive(points, self.poses[index, :3, :3], place)
        views = [votes_of_scan(placed, softmax, voting, size) for size in VOXEL_SIZES_M]
        return PlacedScan(placed, views, nearest_ranges(points))


def fused_labels(tally: Tally, labels: TrainIds) -> TrainIds:
    """Return the labels of points (N,) by all scans that see them; unlabelled ones stay so."""
    fused = (tally.probabilities[:, 1:].argmax(axis=1) + 1).astype(np.uint8)
    return np.where((tally.views > 1) & (labels > 0), fused, labels)


def disagreement(tally: Tally, labels: TrainIds) -> Float:
    """Return which share of the votes is against the label of each point (N,); NaN without any."""
    share = 1 - np.take_along_axis(tally.probabilities, labels[:, None].astype(np.intp), 1)[:, 0]
    return np.where((tally.views > 0) & (labels > 0), share, np.nan).astype(np.float32)


def voting(softmax: Float) -> npt.NDArray[np.bool_]:
    """Return which points (N,) have a vote by their softmax (N, C): those with a label."""
    return softmax[:, 0] < 1
