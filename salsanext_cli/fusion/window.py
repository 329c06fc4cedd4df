# SPDX-License-Identifier: MIT
"""Fusion of the softmax of scans that see the same places, in a window along the drive."""

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.errors import SalsanextError
from salsanext_cli.fusion.drive import Drive
from salsanext_cli.fusion.pose_checks import Parts, fitting_parts
from salsanext_cli.fusion.poses import Poses
from salsanext_cli.fusion.votes import VOXEL_SIZES_M, Tally, View, tally, view_of
from salsanext_cli.options import FusionReach
from salsanext_cli.records import Float, Scan

MOVABLE_WORDS = (
    *("car", "truck", "bus", "van", "trailer", "vehicle", "train", "rails", "animal"),
    *("bicycle", "motorcycle", "cycle", "rider", "cyclist", "person", "pedestrian", "people"),
)
"""Words in the names of classes of what may move."""


Content = TypeVar("Content")
ReadScan = Callable[[int], tuple[Float, Float, npt.NDArray[np.bool_]]]
"""Function from the number of a scan in its drive to its points (N, 3), their softmax (N, C)
float32, and which of them vote (N,)."""


def movable_classes(space: LabelSpace) -> npt.NDArray[np.bool_]:
    """Return which train ids (C,) are of what may move, by the names of their raw ids."""
    movable = np.zeros(space.class_count, bool)
    for raw, train in space.learning_map.items():
        words = space.labels.get(raw, "").lower().replace("-", " ").replace("_", " ").split()
        movable[train] |= "moving" in words or not set(MOVABLE_WORDS).isdisjoint(words)
    movable[0] = False
    return movable


class DriveWindow(Generic[Content]):
    """Content of the scans around one of a drive, each read once while the window moves on."""

    def __init__(self, parts: Parts, reach: int, read: Callable[[int], Content]) -> None:
        self.parts, self.reach, self.read = parts, reach, read
        self.contents: dict[int, Content | SalsanextError] = {}

    def around(self, index: int) -> tuple[Content, dict[int, Content]]:
        """Return the content of a scan, and of the others in reach in its part of the drive.

        One of the others that cannot be read is left out: its own turn says why.
        """
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


class FusionWindow:
    """Votes of the scans around one of a drive.

    `movable`: (C,) which classes may move.
    """

    def __init__(
        self, drive: Drive, read: ReadScan, reach: FusionReach, movable: npt.NDArray[np.bool_]
    ) -> None:
        self.poses, self.read, self.reach = drive.poses, read, reach
        self.window = DriveWindow(drive.parts, reach.reach, self._views)
        self.counted = {True: np.ones(len(movable), np.uint8), False: (~movable).astype(np.uint8)}

    def tally(self, index: int) -> Tally:
        """Return what the scans of the window say about the places of a scan's points."""
        own, others = self.window.around(index)
        tallies = []
        for size, view in enumerate(own):
            votes = []
            for each, views in others.items():
                near = abs(each - index) <= self.reach.movable_reach
                votes.append((views[size], self.counted[near]))
            tallies.append(tally(view, votes))
        mean = np.mean([each.probabilities for each in tallies], axis=0)
        return Tally(mean, tallies[-1].views)

    def _views(self, index: int) -> list[View]:
        points, softmax, voting = self.read(index)
        pose = self.poses[index]
        # Far from its origin, a frame of the world leaves no digits for voxels.
        place = pose[:3, 3] - self.poses[0, :3, 3]
        placed = points.astype(np.float64) @ pose[:3, :3].T + place
        return [view_of(placed, softmax, voting, size) for size in VOXEL_SIZES_M]


def fused_labels(tally: Tally, labels: TrainIds) -> TrainIds:
    """Return the labels of a scan's points (N,) by all scans that see their places.

    A label changes only where at least one other scan sees the place; unlabelled points stay so.
    """
    fused = (tally.probabilities[:, 1:].argmax(axis=1) + 1).astype(np.uint8)
    return np.where((tally.views > 1) & (labels > 0), fused, labels)


def disagreement(tally: Tally, labels: TrainIds) -> Float:
    """Return which share of the votes is against the label of each point (N,); NaN without any."""
    share = 1 - np.take_along_axis(tally.probabilities, labels[:, None].astype(np.intp), 1)[:, 0]
    return np.where((tally.views > 0) & (labels > 0), share, np.nan).astype(np.float32)


def fuse(
    scans: Sequence[Scan],
    probabilities: Sequence[Float],
    poses: Poses,
    reach: FusionReach = FusionReach(),
    space: LabelSpace | None = None,
) -> list[Tally]:
    """Fuse the softmax of the scans of a drive where they see the same places.

    Parameters
    ----------
    scans : sequence of S Scan
        In the order of the drive.
    probabilities : sequence of S arrays (N, C)
        Softmax of the points of each scan, certain of class 0 for a point without a label.
    poses : (S, 4, 4) float64
        From the frame of each scan to that of the drive, metres.
    reach : FusionReach
        How many scans before and after each vote.
    space : LabelSpace
        Classes, which tell what may move; the built-in ones by default.

    Returns
    -------
    list of S Tally
        ``probabilities`` (N, C) float32, the mean over the scans that see the place of each point,
        and ``views`` (N,), their number.
    """
    from salsanext_cli.classes.label_space import label_space

    def read(index: int) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
        softmax = np.asarray(probabilities[index], np.float32)
        return scans[index].points, softmax, voting(softmax)

    movable = movable_classes(space or label_space("semantic-kitti"))
    poses = np.asarray(poses, np.float64)
    drive = Drive(poses, fitting_parts(poses, lambda index: scans[index].points)[0])
    window = FusionWindow(drive, read, reach, movable)
    return [window.tally(index) for index in range(len(scans))]


def voting(softmax: Float) -> npt.NDArray[np.bool_]:
    """Return which points (N,) have a vote by their softmax (N, C): those with a label."""
    return softmax[:, 0] < 1
