# SPDX-License-Identifier: MIT
"""Semantic Segmentation Editor (sse): ascii PCD files, whose labels are indices of classes."""

from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import LabelError
from salsanext_cli.core.records import Scan
from salsanext_cli.core.texts import counted
from salsanext_cli.io.annotation_tools.tool import (
    AnnotationTool,
    Files,
    LabelledPoints,
    ToolLabels,
    mentions,
    pcd_fields,
)
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.files.reading import present, reading
from salsanext_cli.io.formats.label_scalars import LabelIds, LabelledCloud
from salsanext_cli.io.formats.pcd import read_header
from salsanext_cli.io.formats.pcd_writing import encode_pcd

SETTINGS = "settings.json"
CLASS_SETS = "sets-of-classes"  # Key of the classes in it
LABEL = "label"
OBJECT = "object"  # Field that the editor adds: number of the object of a point, or -1
UNSAVED = "Error while parsing labels file"  # In place of points, if nobody saved the scan


class SemanticSegmentationEditor(AnnotationTool):
    """The editor of Hitachi, whose older versions read no binary PCD files."""

    name = "sse"
    saves = "clouds of sse"

    def scan_files(self, scan: LabelledPoints, space: LabelSpace) -> Files:
        """Return an ascii PCD file, with train ids as labels."""
        name = self.place_of(scan.sequence, scan.stem)
        columns = scan.columns() | {LABEL: space.to_train(scan.labels, source=name)}
        return {f"{name}.pcd": encode_pcd(columns, text=True)}

    def common_files(self, space: LabelSpace) -> Files:
        """Return the settings of the editor, with the classes in the order of their train ids."""
        classes = [
            {"label": name, "color": "#" + bytes(colour.tolist()).hex().upper()}
            for name, colour in zip(space.names, space.colours, strict=True)
        ]
        settings = {
            "configuration": {"images-folder": "", "internal-folder": ""},
            CLASS_SETS: [{"name": space.name, "objects": classes}],
        }
        return {SETTINGS: encode_json(settings)}

    def recognises(self, path: Path) -> bool:
        """Return whether a PCD file has objects, or lies beside the settings of the editor."""
        fields = pcd_fields(path)
        if LABEL not in fields:
            return False
        settings = path.with_name(SETTINGS)
        return OBJECT in fields or (present(settings) and mentions(settings, f'"{CLASS_SETS}"'))

    def read(self, path: Path, scan: Scan, space: LabelSpace) -> ToolLabels:
        """Read a PCD file; the labels are train ids."""
        if mentions(path, UNSAVED):
            hint = "save the scan in the editor and download it again, or remove the file"
            problem = "has no points, since the scan was not saved in the editor"
            raise LabelError(path, problem, "a cloud with labels", hint)
        cloud = LabelledCloud.read(path, LABEL, scan.notes.frame)
        _require_whole(path, len(cloud.points), len(scan))
        return ToolLabels(cloud=cloud, meanings=LabelIds.from_train_ids(space), is_in_order=False)


def _require_whole(path: Path, points: int, points_of_scan: int) -> None:
    """Refuse a file that lacks points of the scan and of its header: a download that was cut."""
    with reading(path) as file:
        stated = read_header(file, path).point_count
    if points < min(stated, points_of_scan):
        problem = f"has {counted(points, 'point')}, but its header states {stated:,}"
        raise LabelError(path, problem, "all points of the scan", "download it again")
