# SPDX-License-Identifier: MIT
"""Files of Semantic Segmentation Editor, written and read here as the editor does."""

import json

import numpy as np
import pytest
from picked_for_tools import POINTS, SPACE, PickedForTool
from scans import files_below

SCAN = ("08", "000011")


@pytest.fixture
def picked(tmp_path):
    picked = PickedForTool(tmp_path, "sse")
    picked.write()
    return picked


def opened(path):
    """Read a file as the editor does: words of the header, and lines that end with a newline."""
    header, _, data = path.read_text("ascii").partition("DATA ascii\n")
    words = {line.split()[0]: line.split()[1:] for line in header.splitlines()}
    assert words["VIEWPOINT"] == ["0", "0", "0", "1", "0", "0", "0"]
    assert (words["POINTS"], words["HEIGHT"]) == ([str(POINTS)], ["1"])
    rows = [line.split(" ") for line in data.split("\n")[:-1]]
    columns = dict(zip(words["FIELDS"], zip(*rows, strict=True), strict=True))
    return {name: [float(word) for word in column] for name, column in columns.items()}


def saved(path, columns, labels):
    """Write a file as the endpoint `api/pcdfile` does, with objects."""
    header = (
        "VERSION .7\nFIELDS x y z label object\nSIZE 4 4 4 4 4\nTYPE F F F I I\n"
        f"COUNT 1 1 1 1 1\nWIDTH {len(labels)}\nHEIGHT 1\nPOINTS {len(labels)}\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nDATA ascii\n"
    )
    rows = zip(columns["x"], columns["y"], columns["z"], labels, strict=True)
    path.parent.mkdir(exist_ok=True)
    path.write_text(header + "".join(f"{x} {y} {z} {int(label)} -1\n" for x, y, z, label in rows))


def test_the_editor_gets_points_indices_and_classes(picked):
    names = ["08_000010.pcd", "08_000011.pcd", "09_000010.pcd", "settings.json"]
    assert sorted(files_below(picked.folder)) == names
    columns = opened(picked.folder / "08_000011.pcd")
    points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float32)
    np.testing.assert_array_equal(points, picked.points(SCAN))
    np.testing.assert_array_equal(columns["label"], SPACE.to_train(picked.before[SCAN]))
    settings = json.loads((picked.folder / "settings.json").read_text())
    (classes,) = settings["sets-of-classes"]
    assert tuple(entry["label"] for entry in classes["objects"]) == SPACE.names
    colours = [bytes.fromhex(entry["color"][1:]) for entry in classes["objects"]]
    np.testing.assert_array_equal([list(colour) for colour in colours], SPACE.colours)


def test_three_changed_labels_come_back_exactly(picked, tmp_path):
    edited = tmp_path / "edited"
    for scan in picked.scans:
        name = f"{'_'.join(scan)}.pcd"
        labels = SPACE.to_train(picked.corrected(scan))
        saved(edited / name, opened(picked.folder / name), labels)
    found = picked.import_from(edited)
    assert (found.failures, [scan.tool for scan in found.scans]) == ([], ["sse"] * 3)
    for scan in picked.scans:
        np.testing.assert_array_equal(picked.labels(scan), picked.corrected(scan))
        assert (picked.labels(scan) != picked.before[scan]).sum() == 3


def test_files_that_the_editor_did_not_change_are_pre_labels(picked, tmp_path):
    columns = opened(picked.folder / "08_000011.pcd")
    saved(tmp_path / "edited/08_000011.pcd", columns, columns["label"])
    saved(tmp_path / "edited/09_000010.pcd", opened(picked.folder / "09_000010.pcd"), [7] * POINTS)
    found = picked.import_from(tmp_path / "edited")
    assert [len(found.unedited), len(found.scans)] == [1, 1]
    assert set(picked.labels(("09", "000010"))) == {SPACE.learning_map_inv[7]}


def test_an_index_beyond_the_classes_is_refused_unless_the_user_states_it(picked, tmp_path):
    columns = opened(picked.folder / "08_000011.pcd")
    saved(tmp_path / "08_000011.pcd", columns, [SPACE.class_count] * POINTS)
    (failure,) = picked.import_from(tmp_path / "08_000011.pcd").failures
    assert (failure.code, f"{SPACE.class_count} ({POINTS} points)" in failure.reason) == (
        "label",
        True,
    )
    (tmp_path / "map.yaml").write_text(f"{SPACE.class_count}: car\n")
    found = picked.import_from(tmp_path / "08_000011.pcd", ids=tmp_path / "map.yaml")
    assert found.failures == []
    assert set(picked.labels(SCAN)) == {10}


def test_a_named_field_has_raw_ids(picked, tmp_path):
    columns = opened(picked.folder / "08_000011.pcd")
    saved(tmp_path / "08_000011.pcd", columns, picked.corrected(SCAN))
    found = picked.import_from(tmp_path / "08_000011.pcd", scalar="label")
    assert (found.failures, found.scans[0].tool) == ([], "")
    np.testing.assert_array_equal(picked.labels(SCAN), picked.corrected(SCAN))


def test_a_scan_that_was_not_saved_in_the_editor_is_no_damaged_file(picked, tmp_path):
    path = tmp_path / "edited/08_000011.pcd"
    saved(path, opened(picked.folder / "08_000011.pcd"), [1] * POINTS)
    header = path.read_text().partition("DATA ascii\n")[0]
    path.write_text(f"{header}DATA ascii\nError while parsing labels file.")
    (failure,) = picked.import_from(tmp_path / "edited").failures
    assert (failure.code, failure.files) == ("label", (str(path),))


@pytest.mark.parametrize(
    ("cut", "stated", "codes"), [(40, 0, ["label"]), (40, -40, []), (0, 9, [])]
)
def test_a_download_that_was_cut_at_a_line_is_refused(picked, tmp_path, cut, stated, codes):
    """Points that the user removed are missing in the header too."""
    path = tmp_path / "edited/08_000011.pcd"
    saved(path, opened(picked.folder / "08_000011.pcd"), [1] * POINTS)
    content = path.read_text().replace(f"{POINTS}\n", f"{POINTS + stated}\n")
    rows = content.splitlines(keepends=True)
    path.write_text("".join(rows[: len(rows) - cut]))
    failures = picked.import_from(tmp_path / "edited").failures
    assert [failure.code for failure in failures] == codes


def test_points_at_one_place_keep_their_labels(picked, tmp_path):
    """The editor returns all points in their order."""
    points = picked.root / "sequences/08/velodyne/000011.bin"
    values = np.fromfile(points, "<f4").reshape(-1, 4)
    values[:50, :3] = 0
    values.tofile(points)
    columns = dict(zip("xyz", values.T[:3], strict=True))
    labels = SPACE.to_train(picked.corrected(SCAN))
    saved(tmp_path / "edited/08_000011.pcd", columns, labels)
    assert picked.import_from(tmp_path / "edited").failures == []
    np.testing.assert_array_equal(picked.labels(SCAN), picked.corrected(SCAN))


def test_a_damaged_file_fails_alone(picked, tmp_path):
    good = opened(picked.folder / "08_000011.pcd")
    saved(tmp_path / "edited/08_000011.pcd", good, [1] * POINTS)
    cut = tmp_path / "edited/08_000010.pcd"
    saved(cut, opened(picked.folder / "08_000010.pcd"), [1] * POINTS)
    cut.write_bytes(cut.read_bytes()[:-20])
    found = picked.import_from(tmp_path / "edited")
    assert [failure.files for failure in found.failures] == [(str(cut),)]
    assert [scan.scan for scan in found.scans] == ["08/000011"]
