# SPDX-License-Identifier: MIT
"""Top views of drives on a page, if `fuse` has recorded how their scans fit together."""

from __future__ import annotations

import logging
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.errors import NoInputError, SalsanextError
from salsanext_cli.core.records import Double, Float, Mask
from salsanext_cli.core.texts import counted, printable, with_hint
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.report.colours import legend_of, screen_colours
from salsanext_cli.report.drive_map import drive_map_picture
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.runs.drives.drive_record import DRIVE, poses_of_largest_part
from salsanext_cli.runs.drives.poses_of_sequence import points_of_drive
from salsanext_cli.runs.results.folder_names import FUSED
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.recorded_origins import recorded_origins
from salsanext_cli.runs.scans.scan_file import ScanFile, drive_order
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.runs.summary.comparison import ScanComparison

MAP_SCANS = 100  # Most scans on a map, evenly spaced over the drive
LEAST_SCANS = 2
MAP_POINTS = 400_000  # About so many points are drawn
FARTHEST_M = 50.0  # Farther points are sparse

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveMap:
    """Top view of a drive."""

    description: str
    address: str  # The picture itself, as an address for `img`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedScan:
    """Labelled points of a scan that do not move, in the frame of its drive."""

    points: Double  # (N, 3), metres
    labels: TrainIds  # (N,)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveMaps:
    """Top views of the drives of a run."""

    maps: Sequence[DriveMap]
    problems: Sequence[str]  # Why fused drives have none, in words


def drive_maps(run: RunResults) -> DriveMaps:
    """Draw the drives of a run whose poses are recorded, in its folder or that of fused labels."""
    files = sorted((row.file for row in run.rows), key=drive_order)
    maps: list[DriveMap] = []
    problems: list[str] = []
    for sequence, members in groupby(files, lambda file: file.sequence):
        try:
            with_results = list(members)
            missing = [file for file in run.missing.scans if file.sequence == sequence]
            if len(with_results) + len(missing) < LEAST_SCANS:
                continue  # A view of so few scans was not asked for
            drawn = _drive_map(run.reader, sequence, with_results)
            if drawn is not None:
                maps.append(drawn)
        except SalsanextError as error:
            headline = printable(f"no top view of {sequence}: {error.headline}")
            hint = printable(error.hint)
            log.warning("%s", with_hint(headline, hint))
            problems.append("; ".join(filter(None, (headline, hint))))
    return DriveMaps(maps=maps, problems=problems)


def _drive_map(reader: ScanComparison, sequence: str, files: Sequence[ScanFile]) -> DriveMap | None:
    """Draw the largest part of a drive that fits together; None without a record of a drive.

    Raises
    ------
    SalsanextError
        If poses, scans or labels of a recorded drive are missing or damaged.
    """
    poses = _poses(reader.out, sequence)
    if poses is None:
        return None
    chosen = evenly_spaced([file for file in files if file.stem in poses], MAP_SCANS)
    if len(chosen) < LEAST_SCANS:
        problem = f"has results of only {counted(len(chosen), 'scan')}"
        raise NoInputError(
            "the largest part whose poses connect", problem, f"at least {LEAST_SCANS}"
        )
    space = reader.space
    scans = list(_placed_scans(reader, chosen, poses, MAP_POINTS // len(chosen)))
    points = np.concatenate([scan.points for scan in scans])
    labels = np.concatenate([scan.labels for scan in scans])
    trajectory = np.array([poses[file.stem][:3, 3] for file in chosen])
    moving = ", without movable classes" if space.movable.any() else ""
    text = f"Top view of {printable(sequence)}: {counted(len(chosen), 'scan')}{moving}"
    colours = screen_colours(space)[labels]
    png = drive_map_picture(text, points, colours, trajectory, legend_of(space, labels))
    address = f"data:image/png;base64,{b64encode(png).decode('ascii')}"
    return DriveMap(description=text, address=address)


def _poses(out: Path, sequence: str) -> dict[str, Double] | None:
    """Return the recorded poses (4, 4) of a sequence, by stem, of this run or its fused labels."""
    folders = (out / "sequences" / sequence, out / FUSED / "sequences" / sequence)
    recorded = (folder for folder in folders if present(folder / DRIVE))
    return next(map(poses_of_largest_part, recorded), None)


def _placed_scans(
    reader: ScanComparison, files: Sequence[ScanFile], poses: dict[str, Double], most: int
) -> Iterator[PlacedScan]:
    """Yield the scans with about as many of their points as requested."""
    origin_of = recorded_origins(reader.out, reader.sensor)
    for file in files:
        path = output_path(reader.out, file.sequence, "predictions", file.stem)
        points = points_of_drive(file, reader.sensor, origin_of)
        labels = reader.space.to_train(read_labels(path, len(points)), strict=False, source=path)
        chosen = np.flatnonzero(_is_drawn(points, labels, reader.space))
        chosen = chosen[:: max(1, len(chosen) // most)]
        pose = poses[file.stem]
        placed = points[chosen].astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        yield PlacedScan(points=placed, labels=labels[chosen])


def _is_drawn(points: Float, labels: TrainIds, space: LabelSpace) -> Mask:
    """Return which points (N, 3) have a label of a class that does not move, and are near."""
    with np.errstate(invalid="ignore", over="ignore"):
        is_near = np.hypot(points[:, 0], points[:, 1]) < FARTHEST_M
    return is_near & (labels > 0) & ~space.movable[labels]
