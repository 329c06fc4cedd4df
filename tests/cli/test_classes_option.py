# SPDX-License-Identifier: MIT
"""`--classes` as it is typed."""

import pytest
import yaml
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


@pytest.mark.parametrize(
    ("classes", "message"),
    [
        ("corse", "error: corse · no such file · expected a .yaml file or one of"),
        ("split.yaml", "error: label space split · car is split into car and bicycle · expected"),
        ("few.yaml", "error: label space few · no raw id 1 (outlier)"),
    ],
)
def test_what_is_no_merging_is_one_line(
    run, data, weights, tmp_path, monkeypatch, classes, message
):
    monkeypatch.chdir(tmp_path)
    space = label_space().to_dict() | {"name": "split"}
    space["learning_map"] = {**space["learning_map"], 252: 2}
    (tmp_path / "split.yaml").write_text(yaml.safe_dump(space))
    few = {"labels": {0: "a", 10: "b"}, "learning_map": {0: 0, 10: 1}}
    (tmp_path / "few.yaml").write_text(yaml.safe_dump(few | {"learning_map_inv": {0: 0, 1: 10}}))
    result = run("predict", data, "out", "--weights", weights, "--classes", classes)
    assert result.exit_code == 2
    assert result.stderr.startswith(message)
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
