# SPDX-License-Identifier: MIT
"""Import of labels on the command line."""

import json
import shutil

import pytest
from command_line import only_json
from edited_clouds import write_ply

from salsanext_cli import label_space, read_labels, read_scan


@pytest.fixture
def edited(data, tmp_path):
    """Return a folder with a cloud of each scan, one of them with a raw id that is unknown."""
    for stem, more in (("000000", 0), ("000001", 2)):
        points = read_scan(data / f"sequences/08/velodyne/{stem}.bin").points
        labels = read_labels(data / f"sequences/08/labels/{stem}.label")
        write_ply(tmp_path / f"edited/{stem}_done.ply", points, {"Mine": labels + more})
    shutil.rmtree(data / "sequences/08/labels")
    return tmp_path / "edited"


def test_what_is_imported_and_what_is_not_is_said(run, data, edited):
    refused = run("import-labels", edited, data)
    assert refused.exit_code == 1
    assert "no label among the scalars x, y, z, Mine" in refused.stderr
    assert refused.stdout == ""
    done = run("import-labels", edited, data, "--scalar", "mine")
    assert done.exit_code == 1
    assert [line for line in done.stdout.splitlines() if "08/000000" in line]
    assert "unknown label ids 2 (" in done.stderr
    assert f"import-labels: 1 scan, 1 file failed → {data}" in done.stderr
    assert "largest classes: " in done.stderr
    assert "without an edited file" not in done.stderr
    (edited / "000001_done.ply").unlink()
    again = run("import-labels", edited, data, "--scalar", "mine")
    assert "without an edited file, as they were: 1 scan" in again.stderr
    assert "merged" not in again.stderr
    shutil.copy(edited / "000000_done.ply", edited / "000000_more.ply")
    both = run("import-labels", edited, data, "--scalar", "mine")
    assert both.exit_code == 0
    assert "merged from several files: 1 scan" in both.stderr


def test_json_has_the_numbers(run, data, edited, tmp_path):
    single = edited / "000000_done.ply"
    found = only_json(run("import-labels", single, data, "--scalar", "Mine", "--json"))
    (row,) = found["scans"]
    assert row["points"] == 1500 == row["labelled"] + row["unlabelled"]
    assert (found["stage"], found["kept"], found["failures"]) == ("import-labels", 1, [])
    failed = run("import-labels", edited, data, "--json")
    assert failed.exit_code == 1
    assert only_json(failed)["failures"][0]["code"] == "format"


def test_a_label_space_that_is_not_the_data_sets_is_wrong_use(run, data, edited):
    (data / "labels.yaml").write_text(json.dumps(label_space().to_dict()))
    refused = run("import-labels", edited, data, "--scalar", "mine", "--label-space", "coarse")
    assert refused.exit_code == 2
    assert "labels.yaml has other classes or ids" in refused.stderr
