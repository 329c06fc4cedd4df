# SPDX-License-Identifier: MIT
"""Commands on your own data: convert, pick, import-labels, submit."""

import json
import math
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_line import only_json, subject
from edited_clouds import write_ply

from salsanext_cli import label_space, read_labels, read_scan, write_labels
from salsanext_cli.commands.line.output.after_pick import (
    commands_after_pick,
    lines_after_pick,
    scale_text,
)
from salsanext_cli.commands.picked_labels import PickedLabels
from salsanext_cli.commands.stages import submit as stage
from salsanext_cli.commands.stages.pick import Picking
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.io.annotation_tools.registry import TOOLS
from salsanext_cli.runs.annotation.picked_data_set import PickedScan, UncertaintyScale
from salsanext_cli.runs.loop.run import Outcome
from salsanext_cli.runs.results.output_paths import output_path


def test_a_topic_of_a_recording_is_named(run, tmp_path):
    pytest.importorskip("rosbags")
    from bags import messages, structured, write_bag

    points = [structured(seed=seed) for seed in range(3)]
    path = write_bag(tmp_path, ".mcap", [*messages(points[:1], "/a"), *messages(points[1:3], "/b")])
    refused = run("convert", path, tmp_path / "data")
    assert refused.exit_code == 2
    assert "/a (200 points), /b (200 points)" in refused.stderr
    done = run("convert", path, tmp_path / "data", "--topic", "/b", "--json")
    printed = only_json(done)
    assert (printed["done"], printed["next"]) == (2, f"salsanext predict {tmp_path / 'data'}")
    run("project", path, tmp_path / "out", "--topic", "b", "--sensor", "vlp16", status=0)
    assert run("inspect", path, "--topic", "/a", "--json").exit_code == 0
    wrong = run("project", tmp_path, tmp_path / "out", "--topic", "/b")
    assert (wrong.exit_code, subject(wrong)) == (2, "--topic")


def test_pick_names_the_next_commands_and_the_scans_that_failed(run, data, tmp_path, weights):
    out = tmp_path / "to label"
    picked = run("pick", data, out, "--count", 1, "--weights", weights, status=0)
    assert "pick: 1 of 2 scans → " in picked.stderr
    assert f"next: salsanext report '{out}'\n" in picked.stderr
    assert f"salsanext train '{out}' runs/mine --recipe finetune" in picked.stderr
    assert "uncertainty of all scans: " in picked.stderr
    assert " labelled scans gained " in picked.stderr
    run("report", out, status=0)
    assert (out / "predicted/report.html").is_file()
    broken = data / "sequences/08/velodyne/000002.bin"
    broken.write_bytes(b"x")
    picked = run("pick", data, tmp_path / "out", "--weights", weights, "--json")
    assert picked.exit_code == 1
    result = only_json(picked)
    assert (result["stage"], result["scans"], len(result["picked"])) == ("pick", 3, 2)
    assert result["picked"][0]["distance"] is None
    uncertainty = [scan["uncertainty"] for scan in result["picked"]]
    scale = result["scale"]
    assert [scale["least"], scale["most"]] == [min(uncertainty), max(uncertainty)]
    assert scale["median"] == pytest.approx(sum(uncertainty) / 2)
    assert result["predicted"] == str(tmp_path / "out/predicted")
    assert [failure["code"] for failure in result["failures"]] == ["format"]
    assert f"error: {broken}: " in picked.stderr


def test_pick_names_the_folder_of_a_labelling_tool(run, data, tmp_path, weights):
    picking = ("pick", data, tmp_path / "out", "--count", 1, "--weights", weights)
    wrong = run(*picking, "--for", "point_labeler")
    assert (wrong.exit_code, subject(wrong)) == (2, "--for point_labeler")
    text = " ".join(run("pick", "--help", status=0).stdout.split())
    assert all(name in text for name in TOOLS)
    events = tmp_path / "events.jsonl"
    result = only_json(run(*picking, "--for", "sse", "--json", "--events", events))
    lines = [json.loads(line) for line in events.read_text().splitlines()]
    series = [(line["command"], line["count"], line["total"]) for line in lines]
    assert series == [("pick", 1, 2), ("pick", 2, 2), ("pick", 1, 1), ("pick", 1, 1)]
    assert result["tool_folder"] == str(tmp_path / "out/tools/sse")
    assert len([*(tmp_path / "out/tools/sse").glob("*.pcd")]) == 1
    again = run(*picking, status=0)
    assert "labelling tool" not in again.stderr


def test_pick_prints_the_failures_of_the_labels_of_picked_scans(
    run, data, tmp_path, weights, monkeypatch
):
    """A picked scan that is damaged before it is labelled."""
    out = tmp_path / "to-label"
    broken = out / "sequences/08/velodyne/000000.bin"

    def after_damage(*arguments, **options):
        broken.write_bytes(b"x")
        return predict_scans(*arguments, **options)

    monkeypatch.setattr("salsanext_cli.commands.picked_labels.predict_scans", after_damage)
    picked = run("pick", data, out, "--weights", weights, "--json", status=1)
    failures = only_json(picked)["failures"]
    assert [(failure["scan"], failure["code"]) for failure in failures] == [(str(broken), "format")]
    assert f"error: {broken}: " in picked.stderr


def test_inspect_names_range_images_only_with_a_fit(run, data, tmp_path):
    plain = run("inspect", data, status=0)
    assert "Scans" in plain.stdout
    assert "Range images" not in plain.stdout
    fitted = run("inspect", data, "--fit", tmp_path / "mine.toml", "--width", 128, status=0)
    assert re.search(r"Range images of .*, 64×128", fitted.stdout)


def test_pick_takes_the_scans_of_a_list_instead_of_a_number(run, data, tmp_path, weights):
    listed = tmp_path / "tagged.txt"
    listed.write_text("08/000001\n")
    wanted = ("--from", listed, "--weights", weights)
    both = run("pick", data, tmp_path / "out", *wanted, "--count", 1, status=2)
    assert "--count" in both.stderr
    picked = run("pick", data, tmp_path / "out", *wanted, "--json", status=0)
    assert [scan["scan"] for scan in only_json(picked)["picked"]] == ["000001"]


@pytest.fixture
def edited(data, tmp_path):
    """Return a folder with a cloud of each scan, one of them with a raw id that is unknown."""
    for stem, more in (("000000", 0), ("000001", 2)):
        points = read_scan(data / f"sequences/08/velodyne/{stem}.bin").points
        labels = read_labels(data / f"sequences/08/labels/{stem}.label")
        write_ply(tmp_path / f"edited/{stem}_done.ply", points, {"Mine": labels + more})
    shutil.rmtree(data / "sequences/08/labels")
    return tmp_path / "edited"


def test_imported_scans_are_listed_and_failed_files_are_errors(run, data, edited):
    refused = run("import-labels", edited, data)
    assert (refused.exit_code, refused.stdout) == (1, "")
    done = run("import-labels", edited, data, "--scalar", "mine")
    assert done.exit_code == 1
    assert [line for line in done.stdout.splitlines() if "08/000000" in line]
    assert f"import-labels: 1 scan, 1 file failed → {data}" in done.stderr
    assert "largest classes: " in done.stderr
    (edited / "000001_done.ply").unlink()
    again = run("import-labels", edited, data, "--scalar", "mine", "--json")
    result = only_json(again)
    (row,) = result["scans"]
    assert row["points"] == 1500 == row["labelled"] + row["unlabelled"]
    assert (result["stage"], result["unchanged"], result["failures"]) == ("import-labels", 1, [])


def test_another_label_space_than_that_of_the_data_set_is_wrong_use(run, data, edited):
    (data / "labels.yaml").write_text(json.dumps(label_space().to_dict()))
    refused = run("import-labels", edited, data, "--scalar", "mine", "--label-space", "coarse")
    assert refused.exit_code == 2
    assert "labels.yaml" in refused.stderr


@pytest.fixture
def out(tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "SCANS_OF_TEST", dict.fromkeys(stage.SCANS_OF_TEST, 1))
    monkeypatch.chdir(tmp_path)
    for sequence in stage.SCANS_OF_TEST:
        path = output_path(tmp_path / "out", sequence, "predictions", "000000")
        write_labels(path, np.full(5, 40))
    return tmp_path / "out"


def test_a_submission(run, out, tmp_path):
    result = run("submit", "out", "a.zip")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr.splitlines()[-1] == "submit: 11 scans → a.zip"
    assert run("submit", "out", "a.zip").exit_code == 1
    result = only_json(run("submit", "out", "b.zip", "--json", "-q"))
    assert (result["stage"], result["scans"], result["lengths_checked"]) == ("submit", 11, False)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_a_submission_without_a_prediction_is_an_error(run, out, tmp_path):
    output_path(out, "12", "predictions", "000000").unlink()
    result = run("submit", "out", "a.zip", "-q")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: sequence 12: ")
    result = run("submit", "out", "a.zip", "--json")
    printed = only_json(result)
    assert (result.exit_code, printed["zip"]) == (1, None)
    (problem,) = printed["problems"]
    assert [(c["subject"], c["code"]) for c in problem["cases"]] == [("sequence 12", "no-input")]
    assert not (tmp_path / "a.zip").exists()


def test_the_scale_of_the_uncertainties_is_that_of_the_scans_and_the_classes():
    text = scale_text(UncertaintyScale(least=0.00123, median=0.0025, most=0.01, class_count=20))
    assert "0.0012 to 0.0100 nats, median 0.0025" in text
    assert f"{math.log(20):.2f}" in text
    labels = PickedLabels(folder=Path("new/predicted"), failures=(), accuracy=None, verdict=None)
    outcome = Outcome(skipped=0, done=1, failures=())
    for most, distance, printed in (
        (0.01, 0.5, {"uncertainty", "distance"}),
        (0.01, None, {"uncertainty"}),
        (0.00123, 0.5, set()),
    ):
        scale = UncertaintyScale(least=0.00123, median=0.00123, most=most, class_count=20)
        picked = PickedScan(
            rank=1,
            sequence="08",
            scan="000000",
            uncertainty=0.0025,
            distance=distance,
            nearest=None,
            reason="most uncertain",
        )
        picking = Picking(picked=(picked,), scans=1, outcome=outcome, warnings=[], scale=scale)
        lines = [*lines_after_pick(Path("new"), picking, labels, None, ())]
        subjects = {line.split(" ")[0].strip(":") for line in lines}
        assert subjects & {"uncertainty", "distance"} == printed


def test_after_pick_the_training_uses_its_labelled_data_sets_and_weights():
    data_sets = [Path("a b"), Path("c")]
    following = commands_after_pick(Path("new"), Path("edited"), "w.safetensors", data_sets)
    importing = shlex.split(following.split("`")[1])
    assert importing == ["salsanext", "import-labels", "edited", "new"]
    training = shlex.split(following.split("`")[3])
    assert training[:6] == ["salsanext", "train", "new", "runs/mine", "--recipe", "finetune"]
    assert training[6:8] == ["--weights", "w.safetensors"]
    assert training[8:] == ["--also", "a b", "--also", "c"]
    assert "--also" not in commands_after_pick(Path("new"), Path("edited"), None, [])


@pytest.mark.parametrize("tool", [None, *TOOLS.values()])
def test_after_pick_the_import_reads_what_the_tool_saves(tool):
    labels = PickedLabels(folder=Path("new/predicted"), failures=(), accuracy=None, verdict=None)
    outcome = Outcome(skipped=0, done=1, failures=())
    picking = Picking(picked=(), scans=1, outcome=outcome, warnings=[])
    (*_, last) = lines_after_pick(Path("new"), picking, labels, None, (), tool)
    edited = "new/tools/point-labeler" if tool is TOOLS["point-labeler"] else "edited"
    assert f"`salsanext import-labels {edited} new`" in last
