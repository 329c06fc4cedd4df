# SPDX-License-Identifier: MIT
"""Picking scans on the command line."""

from command_line import only_json


def test_the_table_and_what_comes_next(run, data, tmp_path, weights):
    out = tmp_path / "to label"
    found = run("pick", data, out, "--count", 1, "--weights", weights)
    assert found.exit_code == 0, found.output
    assert "most uncertain of 2 scans" in found.stdout
    assert "pick: 1 of 2 scans → " in found.stderr
    assert f"salsanext train '{out}' RUN --recipe finetune" in found.stderr


def test_json_and_exit_status(run, data, tmp_path, weights):
    (data / "sequences/08/velodyne/000002.bin").write_bytes(b"x")
    found = run("pick", data, tmp_path / "out", "--weights", weights, "--json")
    assert found.exit_code == 1
    result = only_json(found)
    assert (result["stage"], result["scans"], len(result["picked"])) == ("pick", 3, 2)
    assert result["picked"][0]["distance"] is None
    assert [failure["code"] for failure in result["failures"]] == ["format"]
    assert "000002.bin" in found.stderr
