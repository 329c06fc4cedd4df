# SPDX-License-Identifier: MIT
"""A data set of `pick` with pre-labels, written for a labelling tool, and its way back."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from scans import SMALL, write_sequence

from salsanext_cli import label_space, read_labels, read_scan
from salsanext_cli.commands.stages.import_labels import import_labels
from salsanext_cli.io.annotation_tools.registry import tool_named
from salsanext_cli.runs.annotation.label_records import LabelImport
from salsanext_cli.runs.annotation.picked_data_set import PickedDataSet, PickedScan
from salsanext_cli.runs.annotation.tool_files import SensorPositions, write_for_tool
from salsanext_cli.runs.scans.layouts import TOOL_FOLDER

SPACE = label_space()
SEQUENCES = {"08": ("000010", "000011"), "09": ("000010",)}
POINTS = 300  # Of a scan
IN_SENSOR_FRAME = SensorPositions(sensor=SMALL)
CHANGED = (3, 57, 240)
"""Points whose labels a person changes."""


class PickedForTool:
    """Scans of two sequences, of which two have one name, in the form of a tool."""

    def __init__(self, folder: Path, tool: str) -> None:
        self.tool = tool
        self.root = folder / "to-label"
        self.folder = self.root / TOOL_FOLDER / tool
        for seed, (sequence, stems) in enumerate(SEQUENCES.items()):
            place = self.root / "sequences" / sequence
            write_sequence(place, stems, count=POINTS, seed=10 * seed)
        self.scans = [(sequence, stem) for sequence, stems in SEQUENCES.items() for stem in stems]
        contents = {scan: self.label_path(scan).read_bytes() for scan in self.scans}
        self.before = {scan: self.labels(scan) for scan in self.scans}
        (self.root / "labels.yaml").write_text(yaml.safe_dump(SPACE.to_dict()))
        digests = {
            "/".join(scan): hashlib.sha256(content).hexdigest()
            for scan, content in contents.items()
        }
        (self.root / "pick.json").write_text(json.dumps({"pre_labels": digests}))

    def write(self, positions: SensorPositions = IN_SENSOR_FRAME) -> None:
        """Write the files for the tool."""
        data_set = PickedDataSet(self.root)
        picked = [
            PickedScan(
                rank=rank,
                sequence=sequence,
                scan=stem,
                uncertainty=0.0,
                distance=None,
                nearest=None,
                reason="",
            )
            for rank, (sequence, stem) in enumerate(self.scans, start=1)
        ]
        with data_set.open():
            write_for_tool(data_set, tool_named(self.tool), picked, positions)

    def label_path(self, scan: tuple[str, str]) -> Path:
        """Return the path of the label file of a scan in the data set."""
        return self.root / "sequences" / scan[0] / "labels" / f"{scan[1]}.label"

    def labels(self, scan: tuple[str, str]) -> npt.NDArray[np.uint32]:
        """Read the labels of a scan in the data set."""
        return read_labels(self.label_path(scan))

    def points(self, scan: tuple[str, str]) -> npt.NDArray[np.float32]:
        """Read the points of a scan in the data set."""
        path = self.root / "sequences" / scan[0] / "velodyne" / f"{scan[1]}.bin"
        return read_scan(path).points

    def corrected(self, scan: tuple[str, str]) -> npt.NDArray[np.uint32]:
        """Return the labels of a scan with three changes: each to the next class."""
        train_ids = SPACE.to_train(self.before[scan])
        places = list(CHANGED)
        train_ids[places] = train_ids[places] % (SPACE.class_count - 1) + 1
        return SPACE.to_raw(train_ids)

    def import_from(self, edited: Path, **options: Any) -> LabelImport:
        """Import labels into the data set."""
        return import_labels(edited, self.root, **options)
