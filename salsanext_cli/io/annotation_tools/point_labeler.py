# SPDX-License-Identifier: MIT
"""The point_labeler of SemanticKITTI: a folder of the odometry benchmark for each sequence."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.geometry.sensor_frame import around
from salsanext_cli.core.poses import CALIBRATION, POSES, Poses
from salsanext_cli.core.records import Scan
from salsanext_cli.io.annotation_tools.tool import AnnotationTool, Files, LabelledPoints, ToolLabels
from salsanext_cli.io.formats.kitti import encode_bin
from salsanext_cli.io.formats.kitti_labels import encode_labels, read_labels
from salsanext_cli.io.formats.label_scalars import LabelIds, LabelledCloud, whole_numbers
from salsanext_cli.io.poses import encode_poses

APART_M = 250.0  # Distance of scans without poses; the tool shows points up to 50 m from a tile
NO_ROTATION = "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n"  # The poses are those of the LiDAR


class PointLabeler(AnnotationTool):
    """The tool that SemanticKITTI was labelled with."""

    name = "point-labeler"
    saves = "label files of point-labeler"
    edits_in_place = True

    def place_of(self, sequence: str, stem: str) -> str:
        """Return the name of the files of a scan in the folder of its sequence."""
        return f"{sequence}/{_stem_of_files(stem)}"

    def scan_files(self, scan: LabelledPoints, space: LabelSpace) -> Files:
        """Return points and labels, as SemanticKITTI has them.

        The tool hides points that are far from the origin, which becomes the sensor.
        """
        points = scan.scan
        if scan.origin is not None:
            seen_from_sensor = around(points.points, np.array(scan.origin))
            points = replace(points, points=seen_from_sensor.astype(np.float32))
        stem = _stem_of_files(scan.stem)
        return {
            f"{scan.sequence}/velodyne/{stem}.bin": encode_bin(points),
            f"{scan.sequence}/labels/{stem}.label": encode_labels(scan.labels),
        }

    def sequence_files(self, sequence: str, stems: Sequence[str], poses: Poses | None) -> Files:
        """Return the poses, and a calibration without rotation; the tool opens none without both.

        The tool has tiles around the trajectory, which it computes in float32 from its origin, and
        takes poses in the order of the names of the files. Hence the first scan is at the origin.
        Scans without poses are placed side by side, so that the tool shows each alone.
        """
        if poses is None:
            poses = np.tile(np.eye(4), (len(stems), 1, 1))
            poses[:, 0, 3] = APART_M * np.arange(len(stems))
        files = [f"{_stem_of_files(stem)}.bin" for stem in stems]
        ordered = poses[np.argsort(files)]
        ordered[:, :3, 3] -= ordered[0, :3, 3]
        return {
            f"{sequence}/{POSES}": encode_poses(ordered),
            f"{sequence}/{CALIBRATION}": NO_ROTATION.encode("ascii"),
        }

    def recognises(self, path: Path) -> bool:
        """Return whether a file is a label file; the tool saves what it got."""
        return path.suffix.lower() == ".label"

    def is_sure_of(self, path: Path) -> bool:
        """Return whether a label file lies in a folder of the tool; others save such, too."""
        return any(folder.name == self.name for folder in path.parents)

    def read(self, path: Path, scan: Scan, space: LabelSpace) -> ToolLabels:
        """Read a label file: raw ids, with instances."""
        ids = whole_numbers(read_labels(path, len(scan)), path, "label")
        return ToolLabels(
            cloud=LabelledCloud(points=scan.points, ids=ids, scalar="labels"),
            meanings=LabelIds.from_space(space),
            is_in_order=True,
        )


def _stem_of_files(stem: str) -> str:
    """Return the name of the files of a scan; the tool cuts the names of label files at a dot."""
    return stem.replace(".", "_")
