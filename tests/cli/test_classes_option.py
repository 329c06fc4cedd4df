# SPDX-License-Identifier: MIT
"""`--classes` as it is typed."""

import pytest
from command_line import every_command, only_json, parsed

from salsanext_cli import label_space

OFFERED = {
    *("predict", "uncertainty", "eval", "export-ply", "export-rrd", "picture", "report", "view"),
    *("compare", "demo"),
}

pytestmark = pytest.mark.usefixtures("undrawn")


def test_every_command_that_shows_classes_of_a_network_offers_it():
    offering = {
        name
        for name in every_command()
        if any("--classes" in option.opts for option in parsed(name).params)
    }
    assert offering == OFFERED


def test_the_way_of_a_user(run, data, weights, tmp_path):
    of_network = ("--weights", weights, "--device", "cpu")
    out = tmp_path / "out"
    result = run("predict", data, out, *of_network, "--classes", "coarse", "--limit", 1)
    assert result.exit_code == 0
    assert "merged into the classes of coarse" in result.stderr
    found = only_json(run("eval", out, "--json", "-q"))
    assert found["label_space"] == "coarse"
    assert found["classes"] == list(label_space("coarse").names)
    assert run("export-ply", out, "-q").exit_code == 0
    merged = only_json(run("eval", out, "--json", "-q", "--classes", "coarse"))
    assert merged["scores"] == found["scores"]
