# SPDX-License-Identifier: MIT
"""Map of a drive: one point per voxel, without the trails of what moves."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import SalsanextError
from salsanext_cli.formats.npy import read_array
from salsanext_cli.fusion.drive import Drive, recorded_drive
from salsanext_cli.fusion.poses import Poses
from salsanext_cli.fusion.votes import keys_of
from salsanext_cli.fusion.window import DriveWindow, movable_classes
from salsanext_cli.geometry.projection import measured_ranges, project
from salsanext_cli.options import FusionReach
from salsanext_cli.records import Float, Scan
from salsanext_cli.results.layout import ScanFile, output_path
from salsanext_cli.results.result_folder import ResultFolder, scalar_columns
from salsanext_cli.sensors.sensor import Sensor

SAME_PLACE_M, GRAZING = 0.3, 0.1
"""Difference of ranges up to which two scans see the same thing, and the share of the range that
must come to it until one sees through: that much it differs within a pixel on flat ground."""
MERGED_POINTS = 1 << 20
"""Points that wait at least until they are merged into a map."""

Columns = dict[str, npt.NDArray[Any]]
"""Values by name, each (N,): x, y, z float64 metres in the world, range, scan, and any others."""


def drive_of_map(results: ResultFolder, files: Sequence[ScanFile]) -> Drive | None:
    """Return the drive by which `fuse` wrote the labels of scans of a sequence, None without."""
    folder = results.root / "sequences" / files[0].sequence
    return recorded_drive(folder, [file.stem for file in files])


def one_per_voxel(parts: Sequence[Columns], size: float, origin: Poses) -> Columns:
    """Join points; keep of each voxel that measured from nearest, of the first scan if several."""
    names = [name for name in parts[0] if all(name in part for part in parts)]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in names}
    keys = keys_of(np.stack([joined[axis] for axis in "xyz"], axis=1) - origin, size)
    order = np.lexsort((joined["scan"], joined["range"], keys))
    first = order[np.diff(keys[order], prepend=-1) != 0]
    return {name: values[first] for name, values in joined.items()}


class SeenScan(NamedTuple):
    """A scan with its results."""

    columns: Columns  # Of its points with a label
    ranges: Float  # (H·W,) of its range image, NaN without a point


@dataclass(frozen=True, slots=True)
class MapTask:
    """Points of the scans of a drive for its map, as `run_over_scans` takes it."""

    results: ResultFolder
    files: tuple[ScanFile, ...]  # Those of one sequence, with labels
    poses: Poses
    space: LabelSpace
    size: float  # Edge of a voxel, metres
    max_chunk_scans: int = 400  # Neighbours share what they read

    def open(self) -> Any:
        """Return the function that works on scans; the window moves from one to the next."""
        return self._attempts

    def _attempts(self, files: Iterable[ScanFile]) -> Iterator[tuple[ScanFile, Any, Any]]:
        sensor = self.results.sensor()
        window = DriveWindow(self.poses, FusionReach().reach, partial(self._seen, sensor=sensor))
        numbers = {file: number for number, file in enumerate(self.files)}
        for file in files:
            try:
                own, others = window.around(numbers[file])
            except SalsanextError as error:
                yield file, None, error
                continue
            columns = one_per_voxel([own.columns], self.size, self.poses[0, :3, 3])
            stays = self._standing(columns, others, sensor)
            yield file, {name: values[stays] for name, values in columns.items()}, None

    def _standing(
        self, columns: Columns, others: Mapping[int, SeenScan], sensor: Sensor
    ) -> npt.NDArray[np.bool_]:
        """Return which points (N,) are of what stands still.

        Of a class that may move, more scans see something in their place than see through it; of
        others, whose labels may be wrong, at most twice as many see through it.
        """
        places = np.stack([columns[axis] for axis in "xyz"], axis=1)
        there, through = np.zeros((2, len(places)), np.int32)
        for index, seen in others.items():
            pose = self.poses[index]
            points = ((places - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32)
            scan = Scan(points, np.zeros(len(points), np.float32))
            image = project(scan, replace(sensor, out_of_view="drop"))
            pixel = image.pixel_of_point
            behind = np.where(pixel >= 0, seen.ranges[pixel], np.nan) - image.point_range
            there += np.abs(behind) <= SAME_PLACE_M
            through += behind > SAME_PLACE_M + GRAZING * image.point_range
        labels = self.space.to_train(columns["label"], strict=False)
        movable = movable_classes(self.space)[labels]
        return np.where(movable, through < there, through <= 2 * there)

    def _seen(self, index: int, sensor: Sensor) -> SeenScan:
        file, pose = self.files[index], self.poses[index]
        cloud = self.results.read(file, sensor, self.space)
        columns = scalar_columns(cloud, self.space)
        views = output_path(self.results.root, file.sequence, "views", file.stem)
        columns["views"] = read_array(views, "uint16", (len(cloud.scan),))
        placed = cloud.scan.points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        columns |= dict(zip("xyz", placed.T, strict=True))
        columns["scan"] = np.full(len(placed), index, np.int32)
        labels = self.space.to_train(columns["label"], strict=False)
        is_shown = measured_ranges(cloud.scan.points)[1] & (labels > 0)
        image = project(cloud.scan, sensor)
        ranges = np.where(image.point_of_pixel >= 0, image.channels[0], np.float32(np.nan))
        columns = {name: values[is_shown] for name, values in columns.items()}
        return SeenScan(columns, ranges.ravel())
