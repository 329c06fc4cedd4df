# SPDX-License-Identifier: MIT
"""Supervisely: it opens PCD files with names of their labels, and saves points of figures."""

import logging
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import FormatError, LabelError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.core.plain_data import Json
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.texts import counted, first_few, quoted, with_hint
from salsanext_cli.io.annotation_tools.tool import (
    AnnotationTool,
    Files,
    LabelledPoints,
    ToolLabels,
    named_raw_ids,
    pcd_fields,
    read_json_object,
    whole_numbers_of_json,
)
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.files.reading import present, refusing_damage
from salsanext_cli.io.formats.columns import coordinates_of_edited
from salsanext_cli.io.formats.label_scalars import (
    CLASS_BITS,
    Ids,
    LabelIds,
    LabelledCloud,
    raw_ids_of_names,
)
from salsanext_cli.io.formats.pcd import pcd_columns
from salsanext_cli.io.formats.pcd_writing import encode_pcd

LABELS = "labels"  # Field of a PCD file
MAPPING = "class_mapping.json"  # Name of the class by label, or by range of labels such as 3-10
CLOUDS = "pointcloud"  # Folder of the PCD files of an exported dataset
ANNOTATIONS = "ann"  # Folder of their annotations
ANNOTATION = ".pcd.json"  # End of the name of an annotation
POINTS = "point_cloud"  # Geometry of a figure that is a set of points
EXPECTED = "an annotation of a point cloud"
WITHOUT_CLOUD = (
    "annotations without point clouds: their numbers of points are taken for the order of each scan"
)
HINT_OF_CLOUD = f"import the exported data set with its folder {CLOUDS} to compare the points"

log = logging.getLogger(__name__)


class Supervisely(AnnotationTool):
    """The platform, by its format PCD Semantic Labels, and by its export of annotations."""

    name = "supervisely"
    saves = "files of supervisely"

    def scan_files(self, scan: LabelledPoints, space: LabelSpace) -> Files:
        """Return a binary PCD file, with raw ids as labels."""
        raw_ids = (scan.labels & CLASS_BITS).astype(np.uint16)
        name = self.place_of(scan.sequence, scan.stem)
        return {f"{name}.pcd": encode_pcd(scan.columns() | {LABELS: raw_ids})}

    def common_files(self, space: LabelSpace) -> Files:
        """Return the names of all raw ids but that of points without a label."""
        return {MAPPING: encode_json(named_raw_ids(space))}

    def recognises(self, path: Path) -> bool:
        """Return whether a file is an annotation, or a PCD file with names of its labels."""
        if path.name.lower().endswith(ANNOTATION):
            return True
        return _mapping_of(path) is not None and LABELS in pcd_fields(path)

    def lacks_labels(self, path: Path) -> bool:
        """Return whether a PCD file of an exported dataset has an annotation."""
        annotation = path.parent.with_name(ANNOTATIONS) / f"{path.name}.json"
        return path.parent.name == CLOUDS and present(annotation)

    def read(self, path: Path, scan: Scan, space: LabelSpace) -> ToolLabels:
        """Read an annotation, or a PCD file with names of its labels."""
        mapping = _mapping_of(path)
        if path.name.lower().endswith(ANNOTATION) or mapping is None:
            return _read_annotation(path, scan, space)
        cloud = LabelledCloud.read(path, LABELS, scan.notes.frame)
        # As the platform does, it takes labels without a name for none.
        meanings = LabelIds.from_names(_read_mapping(mapping), space, mapping)
        return ToolLabels(
            cloud=cloud,
            meanings=meanings.with_unlabelled(cloud.ids),
            is_in_order=False,
            doubt=_labels_without_name(mapping, meanings.unknown(cloud.ids), space),
        )


def _mapping_of(path: Path) -> Path | None:
    """Return the file with the names of labels, in the folder of a PCD file or above it."""
    if path.suffix.lower() != ".pcd":
        return None
    places = [folder / MAPPING for folder in path.parents[:2]]
    return next((place for place in places if present(place)), None)


def _read_mapping(path: Path) -> dict[int, str]:
    """Read the name of each label."""
    names: dict[int, str] = {}
    expected = 'names of labels, such as {"1": "car", "3-10": "person"}'
    with refusing_damage(path, expected):
        for key, name in read_json_object(path, expected).items():
            ends = [key] if key.lstrip("-").isdecimal() else key.split("-")
            labels = range(int(ends[0]), int(ends[-1]) + 1)
            if len(labels) > CLASS_BITS or not isinstance(name, str):
                raise FormatError(path, f"has the entry {quoted(key)}: {quoted(name)}", expected)
            names |= dict.fromkeys(labels, name)
    return names


def _labels_without_name(mapping: Path, point_counts: Mapping[int, int], space: LabelSpace) -> str:
    """Return the doubt about labels that a file of names lacks, "" for none.

    `point_counts`: number of the points of each such label. That of points without a label needs
    no name.
    """
    labels = sorted(point_counts.keys() - {space.learning_map_inv[0]})
    if not labels:
        return ""
    count = counted(sum(point_counts[label] for label in labels), "point")
    problem = f"{count} have labels without a name in {mapping}: {first_few(labels)}"
    return f"{problem}; they become unlabelled"


def _read_annotation(path: Path, scan: Scan, space: LabelSpace) -> ToolLabels:
    """Read the labels of the points of figures; those of no figure are unlabelled."""
    cloud = path.parent.with_name(CLOUDS) / path.name.removesuffix(".json")
    is_exported = path.parent.name == ANNOTATIONS and present(cloud)
    if not is_exported:
        warn_once(log, with_hint(WITHOUT_CLOUD, HINT_OF_CLOUD))
    if is_exported:
        points = coordinates_of_edited(pcd_columns(cloud), cloud, scan.notes.frame)
    else:
        points = scan.points
    with refusing_damage(path, EXPECTED):
        indices_of_class = _indices_of_classes(read_json_object(path, EXPECTED), path)
    raw_ids = raw_ids_of_names(indices_of_class, space, path)
    ids = np.full(len(points), space.learning_map_inv[0], np.int64)
    figures = np.zeros(len(points), np.int64)
    for name, indices in indices_of_class.items():
        _require_points(path, indices, points)
        ids[indices] = raw_ids[name]
        figures[indices] += 1
    shared = int((figures > 1).sum())
    if shared:
        problem = f"has {counted(shared, 'point')} in figures of several classes"
        raise LabelError(path, problem, "one class per point", "remove them from other figures")
    return ToolLabels(
        cloud=LabelledCloud(points=points, ids=ids, scalar="figures"),
        meanings=LabelIds.from_space(space),
        is_in_order=not is_exported,
    )


def _indices_of_classes(annotation: Json, path: Path) -> dict[str, Ids]:
    """Return the sorted numbers of the points of each class, by its name, without repetitions.

    Refuse objects without a class; `path` is the file, in errors.
    """
    class_of = {entry["key"]: entry.get("classTitle") for entry in annotation["objects"]}
    without = [key for key, name in class_of.items() if not isinstance(name, str) or not name]
    if without:
        problem = f"has objects without a class: {first_few(without)}"
        hint = "choose their classes in the tool, or delete them there"
        raise LabelError(path, problem, "the name of a class of each object", hint)
    indices: defaultdict[str, list[int]] = defaultdict(list)
    for figure in annotation["figures"]:
        if figure["geometryType"] == POINTS:
            indices[class_of[figure["objectKey"]]] += figure["geometry"]["indices"]
    return {name: np.unique(whole_numbers_of_json(places)) for name, places in indices.items()}


def _require_points(path: Path, indices: Ids, points: Float) -> None:
    """Refuse numbers that no point has; they are sorted."""
    if len(indices) and not 0 <= indices[0] <= indices[-1] < len(points):
        problem = "has a figure with points that the scan does not have"
        hint = "use the annotation of this scan, as `pick` wrote it for the tool"
        raise LabelError(path, problem, f"numbers from 0 to {len(points) - 1:,}", hint)
