# SPDX-License-Identifier: MIT
"""Recordings on the command line."""

import pytest

pytest.importorskip("rosbags")

from bags import messages, structured, write_bag
from command_line import only_json

POINTS = [structured(seed=seed) for seed in range(3)]


def test_the_command_line_names_the_topic(run, tmp_path):
    path = write_bag(tmp_path, ".mcap", [*messages(POINTS[:1], "/a"), *messages(POINTS[1:3], "/b")])
    refused = run("convert", path, tmp_path / "data")
    assert refused.exit_code == 2
    assert "2 topics of point clouds: /a, /b · expected one of them · --topic /a" in refused.stderr
    done = run("convert", path, tmp_path / "data", "--topic", "/b", "--json")
    found = only_json(done)
    assert (found["done"], found["next"]) == (2, f"salsanext predict {tmp_path / 'data'}")
    project = run("project", path, tmp_path / "out", "--topic", "b", "--sensor", "vlp16")
    assert project.exit_code == 0, project.output
    assert run("inspect", path, "--topic", "/a", "--json").exit_code == 0
    wrong = run("project", tmp_path, tmp_path / "out", "--topic", "/b")
    assert wrong.exit_code == 2
    assert "is no recording" in wrong.stderr
