# SPDX-License-Identifier: MIT
"""Map of a drive: one point per voxel, without the trails of moving objects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NoInputError
from salsanext_cli.formats.npy import read_array
from salsanext_cli.fusion.drive import DRIVE, Drive, recorded_drive
from salsanext_cli.fusion.poses import POSES
from salsanext_cli.fusion.visibility import GRAZING, SAME_PLACE_M
from salsanext_cli.fusion.votes import keys_of
from salsanext_cli.fusion.window import DriveWindow, in_drive
from salsanext_cli.geometry.projection import measured_ranges, project
from salsanext_cli.records import Double, Float, Mask, Scan
from salsanext_cli.results.paths import ScanFile, output_path
from salsanext_cli.results.result_folder import ResultFolder, scalar_columns
from salsanext_cli.sensors.sensor import Sensor

MERGED_POINTS = 1 << 20  # Points that are collected before they are merged into a map

Columns = dict[str, npt.NDArray[Any]]
"""Values by name, (N,) each: x, y, z float64 metres in the world, range, scan, part, and others."""


def drive_of_map(results: ResultFolder, files: Sequence[ScanFile]) -> Drive:
    """Return the drive that `fuse` recorded for scans of a sequence."""
    folder = results.root / "sequences" / files[0].sequence
    drive = recorded_drive(folder, [file.stem for file in files])
    if drive is None:
        hint = f"run `salsanext fuse {results.root}`, and pass the folder of the fused labels"
        if results.owner("predictions") == "fuse":
            hint = f"run `salsanext fuse OUT {results.root} --overwrite` on results of `predict`"
        problem = f"has no {POSES} and {DRIVE} of `fuse` for these scans"
        raise NoInputError(folder, problem, hint=hint)
    return drive


def one_per_voxel(clouds: Sequence[Columns], size: float, origins: Double) -> Columns:
    """Return the point of each voxel with the least range, of the first scan in a tie.

    Voxels belong to one part of the drive and are counted from its position in `origins` (P, 3).
    """
    names = [name for name in clouds[0] if all(name in cloud for cloud in clouds)]
    joined = {name: np.concatenate([cloud[name] for cloud in clouds]) for name in names}
    places, parts = np.stack([joined[axis] for axis in "xyz"], axis=1), joined["part"]
    keys = keys_of(places - origins[parts], size)
    order = np.lexsort((joined["scan"], joined["range"], keys, parts))
    keys, parts = keys[order], parts[order]
    is_first = (np.diff(keys, prepend=-1) != 0) | (np.diff(parts, prepend=-1) != 0)
    first = order[is_first & (keys >= 0)]
    return {name: values[first] for name, values in joined.items()}


class MapScan(NamedTuple):
    """Scan of a drive with its results."""

    columns: Columns  # Values of the points with a label
    ranges: Float  # (H·W,) float32 of the range image, NaN in empty pixels


@dataclass(frozen=True, slots=True)
class MapTask:
    """Task of `run_over_scans` that selects the points of each scan for the map of its drive."""

    results: ResultFolder
    files: tuple[ScanFile, ...]  # Scans of one sequence, with labels
    drive: Drive
    space: LabelSpace
    size: float  # Edge of a voxel, metres
    reach: int  # Scans before and after each scan that show moving objects
    max_chunk_scans: int = 400  # Neighbours share the contents of files.

    def open(self) -> Callable[[ScanFile], Columns]:
        """Return the function of a scan; its window moves from one scan to the next."""
        sensor = self.results.sensor()
        window = DriveWindow(self.drive.parts, self.reach, partial(self._seen, sensor=sensor))
        numbers = {file: number for number, file in enumerate(self.files)}

        def columns_of(file: ScanFile) -> Columns:
            scan, others = window.around(numbers[file])
            columns = one_per_voxel([scan.columns], self.size, self.drive.origins)
            is_static = self._static(columns, others, sensor)
            return {name: values[is_static] for name, values in columns.items()}

        return columns_of

    def _static(self, columns: Columns, others: Mapping[int, MapScan], sensor: Sensor) -> Mask:
        """Return which points (N,) are on static objects.

        No other scan sees through such a point, or for a movable class fewer than see something
        there. For other classes, whose labels may be wrong, up to twice as many do.
        """
        places = np.stack([columns[axis] for axis in "xyz"], axis=1)
        there, through = np.zeros((2, len(places)), np.int32)
        for index, seen in others.items():
            pose = self.drive.poses[index]
            points = ((places - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32)
            scan = Scan(points, np.zeros(len(points), np.float32))
            image = project(scan, replace(sensor, out_of_view="drop"))
            pixel = image.pixel_of_point
            behind = np.where(pixel >= 0, seen.ranges[pixel], np.nan) - image.point_range
            there += np.abs(behind) <= SAME_PLACE_M
            through += behind > SAME_PLACE_M + GRAZING * image.point_range
        labels = self.space.to_train(columns["label"], strict=False)
        movable = self.space.movable[labels]
        most = np.where(movable, there, 2 * there + 1)
        return (through == 0) | (through < most)

    def _seen(self, index: int, sensor: Sensor) -> MapScan:
        file, pose = self.files[index], self.drive.poses[index]
        cloud = self.results.read(file, sensor, self.space)
        columns = scalar_columns(cloud, self.space)
        views = output_path(self.results.root, file.sequence, "views", file.stem)
        columns["views"] = read_array(views, "uint16", (len(cloud.scan),))
        if "disagreement" in columns:
            columns["probability"] = 1 - columns["disagreement"]
        placed = in_drive(cloud.scan.points, pose[:3, :3], pose[:3, 3])
        columns |= dict(zip("xyz", placed.T, strict=True))
        columns["scan"] = np.full(len(placed), index, np.int32)
        columns["part"] = np.full(len(placed), self.drive.parts[index], np.int32)
        labels = self.space.to_train(columns["label"], strict=False)
        is_shown = measured_ranges(cloud.scan.points)[1] & (labels > 0)
        image = project(cloud.scan, cloud.sensor or sensor)
        ranges = np.where(image.point_of_pixel >= 0, image.channels[0], np.float32(np.nan))
        columns = {name: values[is_shown] for name, values in columns.items()}
        return MapScan(columns, ranges.ravel())
