# SPDX-License-Identifier: MIT
"""Picked scans in the form of a labelling tool, in a folder of their data set."""

import logging
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.poses import POSES, Poses
from salsanext_cli.io.files.reading import filled, present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.labelling_tools.tool import Files, LabelledPoints, LabellingTool
from salsanext_cli.io.poses import pose_readings
from salsanext_cli.runs.labelling.picked_data_set import (
    LABEL_SPACE,
    TOOL_FOLDER,
    PickedDataSet,
    PickedScan,
)

log = logging.getLogger(__name__)


def write_for_tool(
    data_set: PickedDataSet, tool: LabellingTool | None, picked: Sequence[PickedScan]
) -> None:
    """Write the missing files of picked scans for a labelling tool, with their present labels.

    Parameters
    ----------
    data_set : PickedDataSet
        Data set with the scans; those that could not be written are skipped.
    tool : LabellingTool, optional
        The tool; None writes nothing.
    picked : sequence of PickedScan
        The scans.
    """
    scans = [scan for scan in picked if _is_complete(data_set, scan)]
    if tool is None or not scans:
        return
    folder = data_set.root / TOOL_FOLDER / tool.name
    space = label_space(data_set.root / LABEL_SPACE)
    _write_missing(data_set, folder, tool.common_files(space))
    for scan in scans:
        _write_missing(data_set, folder, tool.scan_files(_labelled(data_set, scan), space))
    by_sequence = sorted(scans, key=lambda scan: (scan.sequence, scan.scan))
    for sequence, members in groupby(by_sequence, lambda scan: scan.sequence):
        stems = [scan.scan for scan in members]
        poses = _poses(data_set.root / "sequences" / sequence / POSES, stems)
        _write_current(data_set, folder, tool.sequence_files(sequence, stems, poses))


def _is_complete(data_set: PickedDataSet, scan: PickedScan) -> bool:
    """Return whether a data set has the points and the labels of a scan."""
    paths = data_set.paths(scan.sequence, scan.scan)
    return filled(paths.points) and filled(paths.labels)


def _labelled(data_set: PickedDataSet, picked: PickedScan) -> LabelledPoints:
    """Read a scan and its labels."""
    paths = data_set.paths(picked.sequence, picked.scan)
    scan = read_scan(paths.points)
    labels = read_labels(paths.labels, len(scan))
    return LabelledPoints(sequence=picked.sequence, stem=picked.scan, scan=scan, labels=labels)


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
