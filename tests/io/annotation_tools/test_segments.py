# SPDX-License-Identifier: MIT
"""Labels of Segments.ai, read and written here as the platform documents them."""

import json

import numpy as np
import open3d
import pytest
from picked_for_tools import POINTS, SPACE, PickedForTool
from scans import files_below

SCAN = ("08", "000011")
NAME = "08_000011"


@pytest.fixture
def picked(tmp_path):
    picked = PickedForTool(tmp_path, "segments")
    picked.write()
    return picked


@pytest.fixture
def edited(tmp_path):
    (tmp_path / "edited").mkdir()
    return tmp_path / "edited"


def raw_ids(label):
    """Return the category of each point, 0 for none, as the platform shows it."""
    category_of = {0: 0} | {entry["id"]: entry["category_id"] for entry in label["annotations"]}
    assert 0 not in [entry["id"] for entry in label["annotations"]]
    return [category_of[number] for number in label["point_annotations"]]


def saved(path, labels, *, whole=True):
    """Write a label of several objects per class, whose numbers have gaps and no order."""
    annotations = []
    objects = np.zeros(len(labels), int)
    for place, raw in enumerate(np.unique(labels[labels != 0]).tolist()):
        for half in (0, 1):
            number = 900 - 7 * place - half
            annotations.append({"id": number, "category_id": raw, "attributes": {}})
            objects[(labels == raw) & (np.arange(len(labels)) % 2 == half)] = number
    attributes = {
        "format_version": "0.1",
        "annotations": annotations,
        "point_annotations": objects.tolist(),
    }
    label = {"label_status": "LABELED", "attributes": attributes}
    path.write_text(json.dumps(label if whole else attributes))
    return path


def test_the_platform_gets_points_labels_and_categories(picked):
    stems = ("08_000010", NAME, "09_000010")
    names = [f"{stem}.{suffix}" for stem in stems for suffix in ("json", "pcd")]
    assert sorted(files_below(picked.folder)) == [*names, "categories.json"]
    cloud = open3d.t.io.read_point_cloud(str(picked.folder / f"{NAME}.pcd"))
    np.testing.assert_array_equal(cloud.point.positions.numpy(), picked.points(SCAN))
    label = json.loads((picked.folder / f"{NAME}.json").read_text())
    assert raw_ids(label) == picked.before[SCAN].tolist()
    (version, categories) = json.loads((picked.folder / "categories.json").read_text()).values()
    assert version == "0.1"
    expected = {raw: SPACE.labels[raw] for raw in SPACE.learning_map if raw != 0}
    assert {entry["id"]: entry["name"] for entry in categories} == expected
    for entry in categories:
        np.testing.assert_array_equal(
            entry["color"], SPACE.colours[SPACE.learning_map[entry["id"]]]
        )


@pytest.mark.parametrize("whole", [True, False])
def test_three_changed_labels_come_back_exactly(picked, edited, whole):
    for scan in picked.scans:
        saved(edited / f"{'_'.join(scan)}.json", picked.corrected(scan), whole=whole)
    found = picked.import_from(edited)
    assert (found.failures, len(found.scans)) == ([], 3)
    for scan in picked.scans:
        np.testing.assert_array_equal(picked.labels(scan), picked.corrected(scan))
        assert (picked.labels(scan) != picked.before[scan]).sum() == 3


def test_labels_edited_in_the_folder_of_the_tool_are_the_only_ones_imported(picked):
    saved(picked.folder / f"{NAME}.json", picked.corrected(SCAN))
    found = picked.import_from(picked.folder)
    assert ([scan.scan for scan in found.scans], found.failures) == (["08/000011"], [])
    assert [path.rpartition("/")[2] for path in found.unedited] == [
        "08_000010.json",
        "09_000010.json",
    ]


def test_a_named_cloud_without_labels_fails(picked):
    cloud = picked.folder / f"{NAME}.pcd"
    (failure,) = picked.import_from(cloud).failures
    assert (failure.code, failure.files) == ("format", (str(cloud),))


def test_categories_of_another_dataset_are_stated_by_a_map(picked, edited):
    path = saved(edited / f"{NAME}.json", np.arange(POINTS) % 3 + 500)
    (failure,) = picked.import_from(edited).failures
    assert (failure.code, "500 (100 points)" in failure.reason) == ("label", True)
    (edited / "map.yaml").write_text("0: 0\n500: car\n501: road\n502: 0\n")
    assert picked.import_from(path, ids=edited / "map.yaml").failures == []
    np.testing.assert_array_equal(picked.labels(SCAN), np.tile([10, 40, 0], POINTS // 3))


def label(points, annotations=({"id": 1, "category_id": 10},)):
    return json.dumps({"annotations": [*annotations], "point_annotations": points})


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (label([1] * (POINTS - 1)), "label"),
        (label([1] * (POINTS - 1) + [2]), "label"),
        (label([-1] * POINTS), "label"),
        (label([0] * POINTS), "label"),
        (label([1] * POINTS, []), "label"),
        (label([0.5] * POINTS), "format"),
        (label([[1]] * POINTS), "format"),
        (label([10**30] * POINTS), "format"),
        (label(None), "format"),
        (label([1] * POINTS, [{"id": 1}]), "label"),
        (label([1] * POINTS, [{"id": 1, "category_id": None}]), "label"),
        (label([1] * POINTS, [{"id": 1, "category_id": c} for c in (10, 40)]), "label"),
        (label([1] * POINTS, [{"id": 1, "category_id": "car"}]), "format"),
        (label([1] * POINTS)[:-1], "format"),
        (f"[{label([1] * POINTS)}]", "format"),
    ],
)
def test_wrong_labels_fail_and_change_nothing(picked, edited, content, code):
    path = edited / f"{NAME}.json"
    path.write_text(content)
    (failure,) = picked.import_from(edited).failures
    assert (failure.code, failure.files) == (code, (str(path),))
    np.testing.assert_array_equal(picked.labels(SCAN), picked.before[SCAN])
