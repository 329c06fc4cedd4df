# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from edited_clouds import write_pcd, write_ply
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.io.annotation_tools.registry import TOOLS, lacks_labels, tool_named, tool_of

POINTS = np.eye(3, dtype="f4")
LABELS = np.arange(3, dtype="i4")


def test_each_tool_has_its_name():
    assert all(tool_named(name).name == name for name in TOOLS)
    with refused(UsageError, "tool supervisly"):
        tool_named("supervisly")


@pytest.mark.parametrize(
    ("name", "scalars", "tool"),
    [
        ("a.pcd", {"label": LABELS}, None),
        ("a.pcd", {"object": LABELS}, None),
        ("a.PCD", {"label": LABELS, "object": LABELS}, "sse"),
        ("a.ply", {"label": LABELS, "object": LABELS}, None),
    ],
)
def test_clouds_are_recognised_by_their_fields(tmp_path, name, scalars, tool):
    write = write_ply if name.endswith("ply") else write_pcd
    found = tool_of(write(tmp_path / name, POINTS, scalars))
    assert (found and found.name) == tool


def test_labels_beside_the_settings_of_the_editor_are_indices(tmp_path):
    path = write_pcd(tmp_path / "a.pcd", POINTS, {"label": LABELS})
    settings = tmp_path / "settings.json"
    for content, tool in (('{"theme": "dark"}', None), ('{"sets-of-classes": []}', "sse")):
        settings.write_text(content)
        found = tool_of(path)
        assert (found and found.name) == tool


def test_labels_with_a_file_of_their_names_are_of_supervisely(tmp_path):
    (tmp_path / "class_mapping.json").write_text("{}")
    for folder in (tmp_path, tmp_path / "08"):
        path = write_pcd(folder / "a.pcd", POINTS, {"labels": LABELS})
        assert tool_of(path).name == "supervisely"
    assert tool_of(write_pcd(tmp_path / "b.pcd", POINTS, {"label": LABELS})) is None
    assert tool_of(tmp_path / "ann/08_000010.pcd.json").name == "supervisely"
    assert tool_of(tmp_path / "meta.json") is None


def test_json_with_objects_of_points_is_of_segments(tmp_path):
    path = tmp_path / "a.json"
    for content, tool in (("{}", None), ("", None), ('{"point_annotations": [', "segments")):
        path.write_text(content)
        found = tool_of(path)
        assert (found and found.name) == tool
    cloud = write_pcd(tmp_path / "a.pcd", POINTS, {"intensity": LABELS})
    assert lacks_labels(cloud)
    path.unlink()
    assert not lacks_labels(cloud)


def test_a_damaged_cloud_is_of_no_tool(tmp_path):
    path = tmp_path / "a.pcd"
    path.write_bytes(b"FIELDS label object\n")
    assert tool_of(path) is None
