# SPDX-License-Identifier: MIT
"""Files of Supervisely, read and written here as the platform does."""

import json
import shutil

import numpy as np
import pytest
from edited_clouds import write_pcd
from picked_for_tools import CHANGED, POINTS, SPACE, PickedForTool
from scans import files_below

from salsanext_cli.core.notices import warn_once
from salsanext_cli.io.formats.pcd_writing import encode_pcd
from salsanext_cli.io.frames import FRAMES, encode_frames

SCAN = ("08", "000011")
NAME = "08_000011.pcd"


@pytest.fixture
def picked(tmp_path):
    picked = PickedForTool(tmp_path, "supervisely")
    picked.write()
    return picked


@pytest.fixture
def edited(tmp_path):
    return tmp_path / "edited"


def imported(path):
    """Return the numbers of the points of each class, as the platform reads a file."""
    content = path.read_bytes()
    header, _, data = content.partition(b"DATA binary\n")
    words = {line.split()[0]: line.split()[1:] for line in header.decode().splitlines()}
    kinds = {"F": "f", "U": "u", "I": "i"}
    sizes = zip(words["FIELDS"], words["TYPE"], words["SIZE"], strict=True)
    point_type = np.dtype([(name, f"<{kinds[kind]}{size}") for name, kind, size in sizes])
    assert words["COUNT"] == ["1"] * len(words["FIELDS"])
    assert len(data) == int(words["POINTS"][0]) * point_type.itemsize
    names = json.loads((path.parent / "class_mapping.json").read_text())
    classes = {}
    for number, label in enumerate(np.frombuffer(data, point_type)["labels"].tolist()):
        if str(label) in names:
            classes.setdefault(names[str(label)], []).append(number)
    return classes


def exported(folder, name, classes, *, cloud=None):
    """Write an annotation as the platform exports it, with the cloud that it got."""
    annotation = {"description": "", "key": "0", "tags": [], "objects": [], "figures": []}
    for number, (title, indices) in enumerate(classes.items()):
        key = f"object {number}"
        annotation["objects"].append({"key": key, "classTitle": title, "tags": []})
        figure = {"key": f"figure {number}", "objectKey": key, "geometryType": "point_cloud"}
        annotation["figures"].append({**figure, "geometry": {"indices": indices}})
    path = folder / "ds0/ann" / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(annotation))
    (folder / "meta.json").write_text("{}")
    if cloud is not None:
        (folder / "ds0/pointcloud").mkdir(exist_ok=True)
        shutil.copy(cloud, folder / "ds0/pointcloud" / name)
    return path


def changed(classes, picked, scan):
    """Move the three points that a person corrects to the figures of their classes."""
    others = {name: [i for i in indices if i not in CHANGED] for name, indices in classes.items()}
    for number in CHANGED:
        name = SPACE.labels[int(picked.corrected(scan)[number])]
        others.setdefault(name, []).append(number)
    return others


def test_the_platform_gets_the_points_of_each_class_by_name(picked):
    names = ["08_000010.pcd", NAME, "09_000010.pcd", "class_mapping.json"]
    assert sorted(files_below(picked.folder)) == names
    classes = imported(picked.folder / NAME)
    for raw in SPACE.learning_map_inv.values():
        expected = np.flatnonzero(picked.before[SCAN] == raw).tolist() if raw else []
        assert classes.get(SPACE.labels[raw], []) == expected


@pytest.mark.parametrize("has_clouds", [True, False])
def test_three_changed_labels_of_an_exported_project_come_back_exactly(
    picked, edited, has_clouds, caplog
):
    warn_once.cache_clear()
    for scan in picked.scans:
        name = f"{'_'.join(scan)}.pcd"
        cloud = picked.folder / name
        classes = changed(imported(cloud), picked, scan)
        exported(edited, name, classes, cloud=cloud if has_clouds else None)
    found = picked.import_from(edited)
    assert (found.failures, found.unedited) == ([], [])
    assert caplog.text.count("without point clouds") == (0 if has_clouds else 1)
    for scan in picked.scans:
        np.testing.assert_array_equal(picked.labels(scan), picked.corrected(scan))
        assert (picked.labels(scan) != picked.before[scan]).sum() == 3


def test_a_cloud_of_an_exported_project_may_be_in_map_coordinates(picked, edited):
    frame = (500_000.0, 5_400_000.0, 47.5)
    scans = picked.root / "sequences" / SCAN[0]
    (scans / FRAMES).write_bytes(encode_frames({SCAN[1]: frame}))
    # The order is that of another cloud, so that the points are compared.
    points = picked.points(SCAN)[::-1].astype(np.float64) + frame
    cloud = edited / "map.pcd"
    edited.mkdir()
    cloud.write_bytes(encode_pcd(dict(zip("xyz", points.T, strict=True))))
    ids = picked.corrected(SCAN)[::-1]
    names = {int(raw): SPACE.labels[int(raw)] for raw in np.unique(ids) if raw}
    classes = {name: np.flatnonzero(ids == raw).tolist() for raw, name in names.items()}
    exported(edited, NAME, classes, cloud=cloud)
    cloud.unlink()
    assert picked.import_from(edited).failures == []
    np.testing.assert_array_equal(picked.labels(SCAN), picked.corrected(SCAN))


def test_three_changed_labels_of_pcd_files_come_back_exactly(picked):
    labels = picked.corrected(SCAN)
    write_pcd(picked.folder / NAME, picked.points(SCAN), {"labels": labels.astype("u4")})
    found = picked.import_from(picked.folder)
    assert ([scan.scan for scan in found.scans], len(found.unedited)) == (["08/000011"], 2)
    np.testing.assert_array_equal(picked.labels(SCAN), labels)


def test_ranges_and_labels_without_a_name(picked, edited, caplog):
    labels = np.arange(POINTS) % 4
    write_pcd(edited / NAME, picked.points(SCAN), {"labels": labels.astype("i2")})
    mapping = edited / "class_mapping.json"
    mapping.write_text('{"-1": "person", "1-2": "car"}')
    assert picked.import_from(edited).failures == []
    assert f"{POINTS // 4} points have labels without a name in {mapping}: 3;" in caplog.text
    np.testing.assert_array_equal(picked.labels(SCAN), np.where(np.isin(labels, [1, 2]), 10, 0))
    (edited / "map.yaml").write_text("0: 0\n1: road\n2: road\n3: road\n")
    caplog.clear()
    assert picked.import_from(edited, ids=edited / "map.yaml").failures == []
    assert "without a name" not in caplog.text, "the map names all labels"
    np.testing.assert_array_equal(picked.labels(SCAN), np.where(labels == 0, 0, 40))


@pytest.mark.parametrize(
    "content", ["[]", "{", '{"one": "car"}', '{"1-": "car"}', '{"1": 2}', '{"0-99999999": "car"}']
)
def test_a_damaged_file_of_names_is_refused(picked, edited, content):
    write_pcd(edited / NAME, picked.points(SCAN), {"labels": np.ones(POINTS, "i4")})
    (edited / "class_mapping.json").write_text(content)
    (failure,) = picked.import_from(edited).failures
    assert failure.code == "format"
    assert str(edited / "class_mapping.json") in failure.reason


@pytest.mark.parametrize(
    ("classes", "code"),
    [
        ({"car": [0, POINTS]}, "label"),
        ({"car": [-1]}, "label"),
        ({"car": [0.5]}, "format"),
        ({"car": ["0"]}, "format"),
        ({"spaceship": [0]}, "label"),
        ({"car": [0, 1], "road": [1]}, "label"),
        ({"car": []}, "label"),
        ({}, "label"),
    ],
)
def test_wrong_annotations_fail_and_change_nothing(picked, edited, classes, code):
    path = exported(edited, NAME, classes)
    (failure,) = picked.import_from(edited).failures
    assert (failure.code, failure.files) == (code, (str(path),))
    np.testing.assert_array_equal(picked.labels(SCAN), picked.before[SCAN])


@pytest.mark.parametrize("title", [None, "", 7])
def test_an_object_without_a_class_is_named(picked, edited, title):
    path = exported(edited, NAME, {"car": [0, 1]})
    annotation = json.loads(path.read_text())
    annotation["objects"][0]["classTitle"] = title
    path.write_text(json.dumps(annotation))
    (failure,) = picked.import_from(edited).failures
    assert (failure.code, "object 0" in failure.reason) == ("label", True)


@pytest.mark.parametrize("content", ["[]", '{"objects": [], "figures": [{}]}', '{"objects"'])
def test_damaged_annotations_fail(picked, edited, content):
    path = exported(edited, NAME, {})
    path.write_text(content)
    (failure,) = picked.import_from(edited).failures
    assert (failure.code, str(path) in failure.reason) == ("format", True)


def test_cuboids_are_not_labels(picked, edited):
    path = exported(edited, NAME, {"car": [1, 2]})
    annotation = json.loads(path.read_text())
    cuboid = {"objectKey": "object 0", "geometryType": "cuboid_3d", "geometry": {}}
    annotation["figures"].append(cuboid)
    path.write_text(json.dumps(annotation))
    assert picked.import_from(edited).failures == []
    np.testing.assert_array_equal(np.flatnonzero(picked.labels(SCAN) == 10), [1, 2])
