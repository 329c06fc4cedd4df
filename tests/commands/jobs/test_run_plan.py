# SPDX-License-Identifier: MIT
"""The plan of a run states what the run then does, and changes nothing."""

import json

import pytest
from command_line import only_json, subject
from scans import files_below

CALLS = {
    "extras": ["predict", "--probabilities", "--pixel-labels"],
    "uncertainty": ["uncertainty", "--samples", "2"],
}


@pytest.mark.parametrize("words", CALLS.values(), ids=CALLS)
def test_the_plan_is_what_the_run_does(run, data, weights, tmp_path, words):
    out = tmp_path / "out"
    command, *extras = words
    call = (command, data, out, "--weights", weights, "--device", "cpu", *extras)
    plan = only_json(run(*call, "--dry-run", "--json", status=0))
    assert not out.exists()
    assert [plan[key] for key in ("found", "complete", "todo")] == [2, 0, 2]
    done = only_json(run(*call, "--limit", 1, "--json", status=0))
    assert plan["sensor"] == done["sensor"]
    before = files_below(out)
    planned = run(*call, "--dry-run", status=0)
    assert "2 scans found, 1 done already, 1 to do" in planned.stderr
    assert files_below(out) == before
    run(*call, status=0)
    sizes = [len(content) for content in files_below(out / "sequences").values()]
    assert plan["bytes"] == sum(sizes)
    again = only_json(run(*call, "--dry-run", "--overwrite", "--json", status=0))
    assert (again["complete"], again["todo"]) == (0, 2)
    shard = only_json(run(*call, "--dry-run", "--shard", "1/2", "--json", status=0))
    assert (shard["found"], shard["complete"], shard["todo"]) == (2, 1, 0)


def test_what_the_run_refuses_is_refused_and_stays(run, data, weights, tmp_path):
    out = tmp_path / "out"
    call = ("predict", data, out, "--weights", weights, "--device", "cpu")
    run(*call, status=0)
    before = files_below(out)
    refusals = [
        json.loads(run(*call, "--width", 64, *flag, "--json").stdout)
        for flag in ([], ["--dry-run"])
    ]
    assert refusals[0] == refusals[1]
    assert refusals[0]["code"] == "output"
    assert files_below(out) == before
    planned = only_json(run(*call, "--width", 64, "--overwrite", "--dry-run", "--json", status=0))
    assert planned["todo"] == 2
    assert files_below(out) == before
    (out / "predict.json").unlink()
    before = files_below(out)
    planned = json.loads(run(*call, "--json", "--dry-run").stdout)
    assert files_below(out) == before
    assert planned == json.loads(run(*call, "--json").stdout)
    assert planned["code"] == "output"


def test_range_images_have_no_plan(run, data, weights, tmp_path):
    sensor = tmp_path / "small.toml"
    sensor.write_text("fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 128\n")
    run("project", data, tmp_path / "out", "--sensor", sensor, status=0)
    refused = run("predict", tmp_path / "out", tmp_path / "out", "--dry-run")
    assert (refused.exit_code, subject(refused)) == (2, "--dry-run")
