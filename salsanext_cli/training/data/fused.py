# SPDX-License-Identifier: MIT
"""Drives to learn from: fused labels are the truth where the views of a place agree."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import NoInputError, counted
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.npy import read_array, read_uncertainty
from salsanext_cli.fusion.drive import recorded_drive
from salsanext_cli.fusion.window import FusionWindow, fused_labels, movable_classes, voting
from salsanext_cli.geometry.projection import points_from_pixels, project
from salsanext_cli.options import FusionReach, ScanSelection
from salsanext_cli.records import Float
from salsanext_cli.results.layout import DISAGREEMENT, ScanFile, drive_order, output_path
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.sensors.sensor import Sensor

LEAST_VIEWS, LEAST_MOVABLE_VIEWS = 3, 2
"""Scans that must see a place for its label to teach; the second, of classes that may move."""
LEAST_SCANS = 10
"""Scans that each drive must have: the first half teaches, the second is held out."""


@dataclass(frozen=True, slots=True, order=True)
class FusedScan(ScanFile):
    """A scan whose labels are those that `fuse` wrote."""

    root: Path  # Folder of the fused results
    most: float  # Largest disagreement of labels that teach

    @property
    def label_path(self) -> Path:
        """Path of the fused labels."""
        return output_path(self.root, self.sequence, "predictions", self.stem)

    def taught(self, labels: TrainIds, space: LabelSpace) -> TrainIds:
        """Return the labels of the points (N,) where enough views agree, else 0."""
        folder, name = self.label_path.parents[1], f"{self.stem}.npy"
        against = read_uncertainty(folder / DISAGREEMENT / name, len(labels), 1)
        views = read_array(folder / "views" / name, np.uint16, labels.shape)
        least = np.where(movable_classes(space)[labels], LEAST_MOVABLE_VIEWS, LEAST_VIEWS)
        return np.where((against <= self.most) & (views >= least), labels, np.uint8(0))


def fused_drives(
    root: Path, most: float
) -> tuple[LabelSpace, list[ScanFile], dict[str, list[FusedScan]]]:
    """Return classes of fused results, the scans to train on, and all of each drive in order."""
    results = ResultFolder(root)
    settings, space = results.settings("fuse"), results.label_space()
    if settings is None or "fused_of" not in settings or space is None:
        remedy = "run `salsanext predict SCANS OUT --fuse`, and give OUT/fused"
        raise NoInputError(root, "no fused labels", "a folder that `fuse` filled", remedy)
    files, _ = results.predicted(ScanSelection())
    files = sorted(results.with_column("label", files), key=drive_order)
    drives = {
        name: [FusedScan(f.sequence, f.stem, f.path, root, most) for f in members]
        for name, members in groupby(files, lambda file: file.sequence)
    }
    if short := [name for name, members in drives.items() if len(members) < LEAST_SCANS]:
        found = f"{counted(len(drives[short[0]]), 'scan')} of sequence {short[0]}"
        raise NoInputError(root, found, f"at least {LEAST_SCANS}")
    return space, [f for d in drives.values() for f in d[: len(d) // 2]], drives


def agreement(
    network: Network, drives: Mapping[str, Sequence[FusedScan]], sensors: Mapping[str, Sensor]
) -> float:
    """Return the share of points of the second halves whose labels fusion leaves as they are.

    The network labels each of their scans alone, and what it says of them is fused. Points that no
    other of them sees do not count.
    """
    same = total = 0
    for name, drive in drives.items():
        held = drive[len(drive) // 2 :]
        folder = drive[0].root / "sequences" / name
        placed = recorded_drive(folder, [file.stem for file in held])
        if placed is None:
            raise NoInputError(folder, "no poses of its scans", "those that `fuse` wrote")
        own = network.for_sensor(sensors.get(name, network.sensor))
        labels: dict[int, TrainIds] = {}
        read = partial(_read, held, own, labels)
        window = FusionWindow(placed, read, FusionReach(), movable_classes(network.space))
        for index in range(len(held)):
            tally = window.tally(index)
            seen = (tally.views > 1) & (labels[index] > 0)
            same += int(
                np.count_nonzero((fused_labels(tally, labels[index]) == labels[index])[seen])
            )
            total += int(np.count_nonzero(seen))
    return same / max(total, 1)


def _read(
    drive: Sequence[FusedScan], network: Network, labels: dict[int, TrainIds], index: int
) -> tuple[Float, Float, npt.NDArray[np.bool_]]:
    """Return a scan as `FusionWindow` reads it, and keep its labels."""
    scan = read_scan(drive[index].path, network.sensor)
    image = project(scan, network.sensor)
    of_pixels = network.probabilities(image, drive[index].name)
    labels[index] = network.labels(image, of_pixels)
    none = np.eye(1, network.space.class_count)  # certainly unlabelled
    softmax = points_from_pixels(of_pixels, image.pixel_of_point, none)
    return scan.points, softmax, voting(softmax)
