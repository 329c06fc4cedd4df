# SPDX-License-Identifier: MIT
"""Picked scans in the form of a labelling tool, in a folder of their data set."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import FormatError, UsageError
from salsanext_cli.core.geometry.sensor_of_scan import sensor_of
from salsanext_cli.core.poses import POSES, Poses
from salsanext_cli.core.records import Origin, Origins, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import argument
from salsanext_cli.io.annotation_tools.tool import AnnotationTool, Files, LabelledPoints
from salsanext_cli.io.files.reading import filled, present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.formats.survey.local_frame import NO_SHIFT
from salsanext_cli.io.frames import FRAMES, read_frames
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.poses import pose_readings
from salsanext_cli.runs.annotation.picked_data_set import LABEL_SPACE, PickedDataSet, PickedScan
from salsanext_cli.runs.scans.layouts import TOOL_FOLDER

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPositions:
    """Positions of the sensor in scans that are registered to a map."""

    sensor: Sensor  # Fitted to the scans
    origins: Origins = field(default_factory=dict)  # By name of the scan, those by poses, metres

    def position_in(self, name: str, scan: Scan) -> Origin | None:
        """Return the position in the frame of a scan, metres; None if it is not registered."""
        if not self.sensor.has_registered:
            return None
        member = sensor_of(scan, self.sensor, self.origins.get(name))
        return member.origin if member.registered else None


def write_for_tool(
    data_set: PickedDataSet,
    tool: AnnotationTool,
    picked: Sequence[PickedScan],
    positions: SensorPositions,
) -> None:
    """Write the missing files of picked scans for a labelling tool, with their present labels.

    Parameters
    ----------
    data_set : PickedDataSet
        Data set with the scans; those that could not be written are skipped.
    tool : AnnotationTool
        The tool.
    picked : sequence of PickedScan
        The scans.
    positions : SensorPositions
        Positions of the sensor in the scans.
    """
    scans = [scan for scan in picked if _is_complete(data_set, scan)]
    if not scans:
        return
    require_places(tool, [(scan.sequence, scan.scan) for scan in scans])
    folder = data_set.root / TOOL_FOLDER / tool.name
    space = label_space(data_set.root / LABEL_SPACE)
    _write_missing(data_set, folder, tool.common_files(space))
    origins: dict[str, Origin] = {}
    for scan in scans:
        labelled = _labelled(data_set, scan, positions)
        if labelled.origin is not None:
            origins[scan.name] = labelled.origin
        _write_missing(data_set, folder, tool.scan_files(labelled, space))
    by_sequence = sorted(scans, key=lambda scan: (scan.sequence, scan.scan))
    for sequence, members in groupby(by_sequence, lambda scan: scan.sequence):
        scans_of_sequence = list(members)
        stems = [scan.scan for scan in scans_of_sequence]
        poses = _poses(data_set.root / "sequences" / sequence / POSES, stems)
        if all(scan.name in origins for scan in scans_of_sequence):
            frames = read_frames(data_set.root / "sequences" / sequence / FRAMES)
            poses = _in_map(scans_of_sequence, origins, frames)
        _write_current(data_set, folder, tool.sequence_files(sequence, stems, poses))


def require_places(tool: AnnotationTool, scans: Iterable[tuple[str, str]]) -> None:
    """Refuse scans, by sequence and stem, that have one place in the folder of a tool."""
    scan_at: dict[str, tuple[str, str]] = {}
    for scan in scans:
        place = tool.place_of(*scan)
        other = scan_at.setdefault(place, scan)
        if other is not scan:
            problem = f"would write {'/'.join(other)} and {'/'.join(scan)} to the same files"
            expected = f"one scan for {tool.name}/{place}"
            hint = "choose another tool, or rename one of the scans and pick again"
            raise UsageError(f"{argument('tool')} {tool.name}", problem, expected, hint)


def _is_complete(data_set: PickedDataSet, scan: PickedScan) -> bool:
    """Return whether a data set has the points and the labels of a scan."""
    paths = data_set.paths(scan.sequence, scan.scan)
    return filled(paths.points) and filled(paths.labels)


def _labelled(
    data_set: PickedDataSet, picked: PickedScan, positions: SensorPositions
) -> LabelledPoints:
    """Read a scan and its labels."""
    paths = data_set.paths(picked.sequence, picked.scan)
    scan = read_scan(paths.points)
    labels = read_labels(paths.labels, len(scan))
    return LabelledPoints(
        sequence=picked.sequence,
        stem=picked.scan,
        scan=scan,
        labels=labels,
        origin=positions.position_in(picked.name, scan),
    )


def _in_map(
    scans: Sequence[PickedScan], origins: Mapping[str, Origin], frames: Mapping[str, Origin]
) -> Poses:
    """Return poses (N, 4, 4) float64 of the sensor in the map, without rotation.

    `origins` are positions of the sensor in the frame of each scan, by its name, and `frames` are
    those of the scans in the map, by stem. All are in metres.
    """
    poses = np.tile(np.eye(4), (len(scans), 1, 1))
    for pose, scan in zip(poses, scans, strict=True):
        pose[:3, 3] = np.add(origins[scan.name], frames.get(scan.scan, NO_SHIFT))
    return poses


def _poses(path: Path, stems: Sequence[str]) -> Poses | None:
    """Read the poses of all scans of a sequence; None if they are unknown, with a warning."""
    if not present(path):
        return None
    try:
        return pose_readings(path, stems, stems)[0]
    except FormatError as error:
        log.warning("%s: poses are skipped", error.headline)
        return None


def _write_missing(data_set: PickedDataSet, folder: Path, files: Files) -> None:
    """Write the files of a tool that do not exist."""
    for name, content in files.items():
        data_set.write_missing(folder / name, content)


def _write_current(data_set: PickedDataSet, folder: Path, files: Files) -> None:
    """Write the files of a tool about all scans of a sequence; edited ones stay, with a warning."""
    for name, content in files.items():
        path = folder / name
        if not filled(path):
            data_set.write(path, content)
            continue
        if path.read_bytes() == content:
            continue
        if data_set.foreign_files([path]):
            log.warning("%s: was edited, and stays; it may not fit all scans", path)
        else:
            data_set.write(path, content)
