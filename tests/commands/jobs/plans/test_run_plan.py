# SPDX-License-Identifier: MIT
"""The plan of a run states what the run then does, and changes nothing."""

import json
import shutil

import numpy as np
import pytest
from bags import START, STEP, messages, structured, write_bag
from command_line import only_json, subject
from scans import files_below

from salsanext_cli.io.poses import encode_poses

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


NETWORK = "--weights WEIGHTS --device cpu"
PREDICTED = f"predict DATA OUT {NETWORK} --probabilities"
RUNS: dict[str, tuple[list[str], str]] = {
    "project": ([], "project DATA OUT --weights WEIGHTS"),
    "knn-refine": (
        ["project DATA OUT --weights WEIGHTS", f"predict OUT OUT {NETWORK}"],
        "knn-refine OUT",
    ),
    "fuse": ([PREDICTED], "fuse OUT NEW"),
    "filter": ([PREDICTED], "filter OUT NEW --drop car"),
    "eval": ([PREDICTED], "eval OUT"),
}
"""Commands before, and the one to plan."""
PICK = f"pick DATA NEW --count 1 {NETWORK}"


@pytest.fixture
def typed(run, data, weights, tmp_path):
    """Return a function that runs a typed command; words in capitals are places."""
    places = {
        "DATA": data,
        "OUT": tmp_path / "out",
        "NEW": tmp_path / "new",
        "WEIGHTS": weights,
        "STATIC": tmp_path / "static",
        "OTHER": tmp_path / "other",
        "EVENTS": tmp_path / "events.jsonl",
        "@LIST": f"@{tmp_path / 'list.txt'}",
        "BAG": tmp_path / "drive.bag",
    }
    folder = data / "sequences/08"
    shutil.copy(folder / "velodyne/000000.bin", folder / "velodyne/000001.bin")
    poses = np.tile(np.eye(4), (2, 1, 1))
    (folder / "poses.txt").write_bytes(encode_poses(poses))

    def typed(text, status=0):
        return run(*(places.get(word, word) for word in text.split()), status=status)

    return typed


def names_of(events):
    """Return the names of the scans of the first series in a file of events."""
    lines = [json.loads(line) for line in events.read_text().splitlines()]
    events.unlink()
    return [line["name"] for line in lines[: lines[0]["total"]]]


@pytest.mark.parametrize("name", RUNS)
def test_every_plan_counts_the_scans_that_the_run_then_does(typed, tmp_path, name):
    before, call = RUNS[name]
    for text in before:
        typed(text)
    written = files_below(tmp_path)
    plan = only_json(typed(f"{call} --dry-run --json"))
    assert [plan[key] for key in ("found", "complete", "todo")] == [2, 0, 2]
    assert files_below(tmp_path) == written
    if name == "eval":
        typed(f"{call} --events EVENTS")
        assert names_of(tmp_path / "events.jsonl") == ["08/000000", "08/000001"]
        return
    typed(f"{call} --shard 1/2")
    half = files_below(tmp_path)
    rest = only_json(typed(f"{call} --dry-run --json"))
    assert (rest["complete"], rest["todo"]) == (1, 1)
    of_shard = only_json(typed(f"{call} --dry-run --json --shard 2/2"))
    assert (of_shard["complete"], of_shard["todo"]) == (0, 1)
    typed(f"{call} --events EVENTS")
    assert names_of(tmp_path / "events.jsonl") == ["08/000001"]
    all_files = files_below(tmp_path)
    again = only_json(typed(f"{call} --dry-run --json"))
    assert (again["complete"], again["todo"], again["bytes"]) == (2, 0, 0)
    overwriting = only_json(typed(f"{call} --dry-run --json --overwrite"))
    assert (overwriting["complete"], overwriting["todo"]) == (0, 2)
    assert files_below(tmp_path) == all_files
    sizes = [len(content) for path, content in all_files.items() if path not in half]
    # `filter` states the size with all points.
    assert name == "filter" or rest["bytes"] == sum(sizes)
    assert rest["bytes"] >= sum(sizes)


@pytest.mark.parametrize(
    ("choice", "found", "names"),
    [
        ("DATA OUT --limit 1", 4, ["00/000000"]),
        ("DATA OUT --sequences 08", 4, ["08/000000", "08/000001"]),
        ("@LIST OUT", 1, ["08/000001"]),
        ("BAG OUT", 2, [f"drive/{START}", f"drive/{START + STEP}"]),
    ],
    ids=["limit", "sequences", "list", "bag"],
)
def test_the_plan_of_a_choice_has_the_scans_of_the_run(typed, data, tmp_path, choice, found, names):
    sequences = data / "sequences"
    shutil.copytree(sequences / "08", sequences / "00")
    (tmp_path / "list.txt").write_text(f"{sequences / '08/velodyne/000001.bin'}\n")
    write_bag(tmp_path, ".bag", messages([structured(seed=0), structured(seed=1)]))
    call = f"predict {choice} {NETWORK}"
    plan = only_json(typed(f"{call} --dry-run --json"))
    assert [plan[key] for key in ("found", "complete", "todo")] == [found, 0, len(names)]
    typed(f"{call} --events EVENTS")
    assert names_of(tmp_path / "events.jsonl") == names
    again = only_json(typed(f"{call} --dry-run --json"))
    assert [again[key] for key in ("complete", "todo")] == [len(names), 0]


def test_a_scan_that_cannot_be_read_is_to_do_before_and_after_the_run(typed, data):
    (data / "sequences/08/velodyne/000001.bin").write_bytes(b"short")
    call = f"predict DATA OUT {NETWORK}"
    plan = only_json(typed(f"{call} --dry-run --json"))
    assert (plan["complete"], plan["todo"]) == (0, 2)
    typed(call, status=1)
    again = only_json(typed(f"{call} --dry-run --json"))
    assert (again["complete"], again["todo"]) == (1, 1)


def test_the_plan_of_a_pick_is_what_it_writes(typed, tmp_path):
    written = files_below(tmp_path)
    plan = only_json(typed(f"{PICK} --dry-run --json"))
    assert [plan[key] for key in ("found", "complete", "todo", "picked")] == [2, 0, 2, 1]
    assert files_below(tmp_path) == written
    typed(f"{PICK} --events EVENTS")
    assert len(names_of(tmp_path / "events.jsonl")) == plan["todo"]
    places = [tmp_path / "new" / name for name in ("sequences", "predicted/sequences")]
    size = sum(len(content) for place in places for content in files_below(place).values())
    # Poses and the header of the PLY file are not counted.
    assert plan["bytes"] == pytest.approx(size - 300, abs=300)
    typed(f"{PICK} --events EVENTS")
    (line,) = map(json.loads, (tmp_path / "events.jsonl").read_text().splitlines())
    assert (line["command"], line["state"], line["total"]) == ("pick", "none", 0)
    again = only_json(typed(f"{PICK} --dry-run --json"))
    assert (again["complete"], again["todo"], again["picked"]) == (1, 0, 1)
    (label,) = (tmp_path / "new/predicted").rglob("*.label")
    label.unlink()
    again = only_json(typed(f"{PICK} --dry-run --json"))
    assert (again["complete"], again["todo"], again["picked"]) == (0, 1, 1)


@pytest.mark.parametrize(
    ("before", "calls"),
    [
        (
            [],
            [
                "knn-refine OUT",
                "fuse OUT",
                "filter OUT NEW --drop car",
                "eval OUT",
                f"pick DATA NEW --count 0 {NETWORK}",
                f"pick DATA NEW --for unknown {NETWORK}",
            ],
        ),
        (
            [PREDICTED, "fuse OUT NEW", "filter OUT STATIC --drop car"],
            [
                "fuse OUT OUT",
                "fuse OUT OTHER",
                "fuse OUT NEW --reach 9",
                "filter OUT OTHER",
                "filter OUT STATIC --drop person",
                "eval OUT --fail-under iou.unicorn=2",
                f"pick DATA OUT {NETWORK}",
            ],
        ),
        ([PICK], [f"pick DATA NEW --count 2 {NETWORK}"]),
        (["project DATA OUT --weights WEIGHTS"], ["project DATA OUT --weights WEIGHTS --width 64"]),
    ],
    ids=["nothing", "results", "picked", "projected"],
)
def test_every_plan_refuses_what_the_run_refuses(typed, tmp_path, before, calls):
    for text in before:
        typed(text)
    for call in calls:
        written = files_below(tmp_path)
        planned = typed(f"{call} --dry-run --json", status=None)
        assert files_below(tmp_path) == written
        refused = typed(f"{call} --json", status=None)
        assert planned.exit_code == refused.exit_code > 0, call
        of_plan = json.loads(planned.stdout)
        assert "error" in of_plan
        assert of_plan == json.loads(refused.stdout)
