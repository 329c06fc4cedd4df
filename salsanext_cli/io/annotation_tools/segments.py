# SPDX-License-Identifier: MIT
"""Segments.ai: it opens PCD files, and has the labels of their points in JSON."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import LabelError
from salsanext_cli.core.records import Scan
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.io.annotation_tools.tool import (
    AnnotationTool,
    Files,
    LabelledPoints,
    ToolLabels,
    mentions,
    named_raw_ids,
    read_json_object,
    whole_numbers_of_json,
)
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.files.reading import present, refusing_damage
from salsanext_cli.io.formats.label_scalars import CLASS_BITS, LabelIds, LabelledCloud
from salsanext_cli.io.formats.pcd_writing import encode_pcd

CATEGORIES = "categories.json"
OBJECTS = "annotations"
OBJECT_OF_POINT = "point_annotations"  # Number of the object of each point; 0 for none
VERSION = {"format_version": "0.1"}
EXPECTED = f"a label with {OBJECTS} and {OBJECT_OF_POINT}"


class Segments(AnnotationTool):
    """The platform, by the JSON of its labels of point clouds."""

    name = "segments"
    saves = "labels of segments"

    def scan_files(self, scan: LabelledPoints, space: LabelSpace) -> Files:
        """Return a binary PCD file, and a label that has an object for each class."""
        raw_ids = scan.labels & CLASS_BITS
        classes = np.setdiff1d(raw_ids, space.learning_map_inv[0])
        objects = [
            {"id": number, "category_id": category}
            for number, category in enumerate(classes.tolist(), start=1)
        ]
        is_labelled = np.isin(raw_ids, classes)
        object_of_point = np.where(is_labelled, np.searchsorted(classes, raw_ids) + 1, 0)
        label = {**VERSION, OBJECTS: objects, OBJECT_OF_POINT: object_of_point.tolist()}
        name = self.place_of(scan.sequence, scan.stem)
        return {
            f"{name}.pcd": encode_pcd(scan.columns()),
            f"{name}.json": json.dumps(label, separators=(",", ":")).encode("ascii"),
        }

    def common_files(self, space: LabelSpace) -> Files:
        """Return the categories: name, colour and raw id of each class."""
        names = named_raw_ids(space)
        train_ids = space.to_train(np.array([*names], np.uint32))
        colours = space.colours[train_ids].tolist()
        categories = [
            {"name": name, "id": raw, "color": colour}
            for (raw, name), colour in zip(names.items(), colours, strict=True)
        ]
        return {CATEGORIES: encode_json({**VERSION, "categories": categories})}

    def recognises(self, path: Path) -> bool:
        """Return whether a JSON file has objects of points, also if it is damaged."""
        return path.suffix.lower() == ".json" and mentions(path, f'"{OBJECT_OF_POINT}"')

    def lacks_labels(self, path: Path) -> bool:
        """Return whether a PCD file has its labels in a JSON file of the same name."""
        label = path.with_suffix(".json")
        return path.suffix.lower() == ".pcd" and present(label) and self.recognises(label)

    def read(self, path: Path, scan: Scan, space: LabelSpace) -> ToolLabels:
        """Read a label, or its attributes; categories are raw ids."""
        with refusing_damage(path, EXPECTED):
            label = read_json_object(path, EXPECTED)
            attributes = label.get("attributes", label)
            entries = attributes[OBJECTS]
            category_of = {entry["id"]: entry.get("category_id") for entry in entries}
            _require_categories(path, category_of, len(entries))
            objects = whole_numbers_of_json(attributes[OBJECT_OF_POINT])
            numbers = whole_numbers_of_json([*category_of])
            categories = whole_numbers_of_json([*category_of.values()])
        if len(objects) != len(scan):
            problem = f"has the labels of {counted(len(objects), 'point')}"
            expected = f"{len(scan):,}, one per point of the scan"
            raise LabelError(path, problem, expected, "use the label of this scan")
        unknown = np.setdiff1d(objects, [0, *numbers]).tolist()
        if unknown:
            problem = f"has points of objects that it does not list: {first_few(unknown)}"
            raise LabelError(path, problem, f"objects of {OBJECTS}", "export the label again")
        order = np.argsort(numbers)
        ids = np.full(len(objects), space.learning_map_inv[0], np.int64)
        has_object = objects != 0
        places = np.searchsorted(numbers[order], objects[has_object])
        ids[has_object] = categories[order][places]
        return ToolLabels(
            cloud=LabelledCloud(points=scan.points, ids=ids, scalar=OBJECT_OF_POINT),
            meanings=LabelIds.from_space(space),
            is_in_order=True,
        )


def _require_categories(path: Path, category_of: Mapping[int, int | None], objects: int) -> None:
    """Refuse objects without a category, and several of one number among all objects."""
    without = [number for number, category in category_of.items() if category is None]
    if without:
        problem = f"has objects without a category: {first_few(without)}"
        hint = "choose their categories in the tool, or delete them there"
        raise LabelError(path, problem, "a category of each object", hint)
    if len(category_of) < objects:
        problem = f"has {objects - len(category_of):,} objects with the number of another one"
        raise LabelError(path, problem, "a number for each object", "export the label again")
