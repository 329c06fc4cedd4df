# SPDX-License-Identifier: MIT
"""Commands of the pipeline: results, messages, exit status."""

import hashlib
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import only_json
from scans import SMALL, labels_below, write_array, write_sequence

from salsanext_cli.network.card import read_card
from salsanext_cli.results.paths import output_path
from salsanext_cli.stages import models as stages

ROOT = Path(__file__).parents[2]


@pytest.fixture
def predict(run, data, weights):
    """Return a function that runs `predict` on the data set."""

    def call(out, *arguments):
        return run("predict", data, out, "--weights", weights, "--device", "cpu", *arguments)

    return call


@pytest.fixture
def results(predict, tmp_path):
    """Return an output folder with predictions."""
    out = tmp_path / "out"
    assert predict(out).exit_code == 0
    return out


def undocumented(found, stage):
    """Return the keys of a result that docs/reference/json.md does not list for its stage."""
    page = (ROOT / "docs/reference/json.md").read_text("utf-8")
    sections = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL))
    (own,) = [text for title, text in sections.items() if stage in title.split(", ")]
    rows = re.findall(r"^\| (`.+?`) \|", sections["Keys of every result"] + own, re.MULTILINE)
    return set(found) - {key for row in rows for key in re.findall(r"`(\w+)`", row)}


def test_every_stage_in_turn_each_with_one_object_of_json(run, data, weights, tmp_path):
    out, steps = tmp_path / "out", tmp_path / "steps"
    sensor = tmp_path / "small.toml"
    sensor.write_text("fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 128\n")
    network = ("--weights", weights, "--device", "cpu")
    for arguments in (
        ("project", data, steps, "--sensor", sensor),
        ("predict", steps, steps, *network),
        ("knn-refine", steps),
        ("predict", data, out, *network),
        ("uncertainty", data, out, "--samples", 2, *network),
        ("eval", out),
        ("export-ply", out, "--color", "wrong"),
        ("picture", out, "--color", "wrong", "--colour", "label"),
    ):
        result = run(*arguments, "--json")
        assert result.exit_code == 0, result.output
        found = only_json(result)
        assert (found["schema"], found["stage"]) == (1, arguments[0])
        assert undocumented(found, arguments[0]) == set()
        # What to type next is what comes next here, where it needs no sensor.
        if arguments[0] in ("knn-refine", "uncertainty"):
            assert shlex.split(found["next"])[:2] in (
                ["salsanext", "eval"],
                ["salsanext", "export-ply"],
            )
    assert len(labels_below(out)) == 2
    assert labels_below(out) == labels_below(steps)
    refused = run("predict", steps, tmp_path / "objects", "--objects", *network)
    assert (refused.exit_code, "--objects" in refused.stderr) == (2, True)


def test_columns_are_those_of_the_scans_in_every_stage(run, data, weights, tmp_path):
    out, steps, plain = tmp_path / "out", tmp_path / "steps", tmp_path / "plain"
    network = ("--weights", weights, "--device", "cpu")
    assert run("predict", data, plain, *network).exit_code == 0
    for path in data.rglob("*.bin"):
        table = np.fromfile(path, "<f4").reshape(-1, 4)
        rows = np.column_stack([table[:, 3] * 255, np.full(len(table), -1), table[:, :3]])
        path.write_bytes(rows.astype("<f4").tobytes())
    sensor = tmp_path / "small.toml"
    sensor.write_text(replace(SMALL, intensity_scale=255.0).to_toml())
    seen = ("--sensor", sensor, "--columns", "Intensity, _, x, y, z")
    fitted = tmp_path / "fitted.toml"
    for arguments in (
        ("inspect", data, *seen, "--fit", fitted),
        ("predict", data, out, *network, *seen),
        ("uncertainty", data, out, "--samples", 2, *network, *seen),
        ("eval", "--out", out, "--by-distance"),
        ("export-ply", "--out", out, "--color", "range"),
        ("project", data, steps, *seen),
        ("predict", steps, steps, *network, "--sensor", sensor),
        ("knn-refine", steps),
        ("knn-refine", tmp_path / "again", "--labels", out, "--dataset", data, *seen),
    ):
        result = run(*arguments)
        assert result.exit_code == 0, result.output
    for refined in (out, steps):
        assert labels_below(refined) == labels_below(plain)
    assert 'columns = ["intensity", "_", "x", "y", "z"]' in fitted.read_text()
    wrong = run("predict", data, out, *network, "--columns", "x,y")
    assert wrong.exit_code == 2
    assert "--columns: x,y (expected up to 64 different names" in wrong.stderr


def test_messages_go_to_stderr(predict, weights, tmp_path):
    out = tmp_path / "out"
    first = predict(out)
    assert first.stdout == ""
    found = [line for line in first.stderr.splitlines() if not line.startswith("warning")]
    lines = [re.sub(r"[\d.]+ m?s\b", "T", line) for line in found]
    assert lines[:3] == [
        f"{weights} on cpu by torch in float32",
        f"predict: 2 scans in T, T per scan → {out}",
        "sensor: small, 16×128, view +3° to -25°",
    ]
    assert re.fullmatch(r"largest classes: (\S+ \d+\.\d %(, |$)){5}", lines[3])
    assert lines[4:] == [f"next: salsanext eval {out}"]
    again = predict(out, "-v")
    assert again.exit_code == 0
    assert re.search(rf"\npredict: 0 scans, 2 done already in .+ → {out}\n", again.stderr)
    assert "classes" not in again.stderr
    assert "08/000000: done" in predict(out, "--overwrite", "--verbose").stderr


def test_quiet_prints_errors_only_and_failures_are_in_the_json(predict, data, tmp_path):
    result = predict(tmp_path / "out", "-q")
    assert (result.exit_code, result.output) == (0, "")
    (data / "sequences/08/velodyne/000001.bin").write_bytes(b"1")
    out = tmp_path / "other"
    result = predict(out, "--json", "--quiet")
    assert len(result.stderr.splitlines()) == 1
    assert "000001.bin: 1 bytes" in result.stderr
    found = only_json(result)
    (failure,) = found.pop("failures")
    expected = {"stage": "predict", "done": 1, "skipped": 0, "failed": 1, "out": str(out)}
    assert expected.items() <= found.items()
    assert 0 < found["seconds_per_scan"] <= found["seconds"]
    assert 0 < sum(found["largest_classes"].values()) <= 1
    assert failure["scan"].endswith("000001.bin")
    assert failure["code"] == "format"
    assert "1 bytes" in failure["reason"]
    assert result.exit_code == 1


def test_eval_prints_how_good_the_uncertainty_is_and_notices_when_it_changes(
    run, predict, data, weights, tmp_path
):
    out = tmp_path / "out"
    predict(out, "--probabilities")
    sampled = ("uncertainty", data, out, "--weights", weights, "--device", "cpu")
    assert run(*sampled, "--samples", 2).exit_code == 0
    result = run("eval", "--out", out)
    assert result.exit_code == 0
    assert "eval: 2 scans" in result.stderr
    assert (out / "scores.txt").exists()
    for word in ("car", "NLL", "least_confidence", "mutual_information", "AUSE"):
        assert word in result.stdout
    report = json.loads((out / "eval.json").read_text("utf-8"))
    assert report["settings"]["uncertainty"]["samples"] == 2
    assert run(*sampled, "--samples", 3, "--overwrite").exit_code == 0
    assert run("eval", "--out", out).exit_code == 0
    report = json.loads((out / "eval.json").read_text("utf-8"))
    assert report["settings"]["uncertainty"]["samples"] == 3


def test_errors_of_points_are_evaluated_and_reject_points(run, results, data):
    for stem in ("000000", "000001"):
        path = output_path(results, "08", "uncertainty/error", stem)
        write_array(path, np.linspace(0, 1, 1500, dtype=np.float32))
    result = run("eval", "--out", results)
    assert result.exit_code == 0, result.output
    said = " ".join(result.stdout.split())
    assert "80 % of points with error below 0.8" in said
    assert "error: the probability that a label is wrong" in said
    found = only_json(run("eval", "--out", results, "--json"))
    assert found["kept"]["sentence"] in said
    result = run("export-ply", "--out", results, "--max-error", "0.5")
    assert result.exit_code == 0, result.output
    assert "1,500 points unlabelled for their error" in result.stderr
    found = only_json(run("export-ply", results, "--max-error", 0.5, "--overwrite", "--json"))
    assert found["rejected_points"] == 1500
    assert undocumented(found, "export-ply") == set()


def test_scans_left_out_on_purpose_are_no_failure_but_those_that_lack_results_are(
    run, predict, results, tmp_path
):
    assert predict(tmp_path / "one", "--limit", 1).exit_code == 0
    (results / "sequences/08/predictions/000001.label").unlink()
    for command in ("eval", "export-ply"):
        result = run(command, "--out", tmp_path / "one", "--json")
        assert result.exit_code == 0, result.output
        assert "the other scan is left out: no earlier stage was asked" in result.stderr
        found = only_json(result)
        assert (found["missing"], found["not_asked_for"]) == ([], 1)
        result = run(command, "--out", results, "-q", "--json")
        assert result.exit_code == 1
        assert result.stderr.startswith("error: 1 of 2 scans have no ")
        assert [Path(path).name for path in only_json(result)["missing"]] == ["000001.bin"]


ON_DATA = "{data} other --weights {weights}"


def test_wrong_settings_are_status_two(run, predicted, weights, monkeypatch):
    monkeypatch.chdir(predicted.out.parent)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("SALSANEXT_OUT", str(predicted.out))
    names = {"data": predicted.data.name, "weights": weights}
    for line, says in (
        ("export-ply --colour rainbow", "--colour: rainbow"),
        ("export-ply --max-error 1.5", "--max-error: 1.5"),
        ("export-ply --format obj", "--format: obj"),
        ("picture --colour range --scale 2 1", "--scale: 2.0 1.0"),
        ("picture --colour label --scale 1 2", "--scale: --colour is label"),
        (
            "tune dropout {data} other.safetensors --split valid --weights {weights} --samples 1",
            "--samples: 1",
        ),
        (
            "tune dropout {data} other.safetensors --split valid --weights {weights} --steps 1",
            "--steps: 1",
        ),
        (
            "tune dropout {data} other.safetensors --split valid --weights {weights} --lowest 0.9",
            "--lowest",
        ),
        (f"predict {ON_DATA} --ego a,b,c,d,e,f", "--ego"),
        (f"predict {ON_DATA} --jobs 0", "--jobs: 0"),
        (f"predict {ON_DATA} --limit 0", "--limit: 0"),
        (f"predict {ON_DATA} --batch many", "--batch: 'many'"),
        (f"predict {ON_DATA} --split tset", "split tset: no such split"),
        (f"predict {ON_DATA} --split valid --sequences 08", "both given"),
        (f"predict {ON_DATA} --classes corse", "corse: no such file"),
        (f"predict {ON_DATA} --device cuda:99", "device cuda:99"),
        (f"uncertainty {ON_DATA} --samples 1", "--samples: 1 (expected at least 2"),
        (f"predict {ON_DATA} --sequences ,", "--sequences"),
        (f"predict {ON_DATA} --scheduler tcp://h:1", "--scheduler tcp://h:1: --backend loky"),
        ("knn-refine --label-space none.yaml", "none.yaml: no such file"),
        ("train {data} other --set epoch=3", "--set epoch=3: unknown key epoch"),
        ("import-weights {weights} other.safetensors --dropout 0.2", "leave --dropout out"),
        (f"predict {ON_DATA} --fuse --reject 0.5", "--fuse: with"),
    ):
        result = run(*(word.format(**names) for word in line.split()))
        assert result.exit_code == 2, result.output
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
        assert says in result.stderr, line
        assert not list(Path().glob("other*"))


def test_nothing_to_work_on_is_status_one(run, weights, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "rubbish.safetensors").write_bytes(b"rubbish")
    monkeypatch.setattr(stages, "ARCHITECTURES", {})  # counting takes seconds
    for line, says in (
        ("predict nowhere --weights {weights}", "nowhere: no such file"),
        ("eval --out empty", "empty: holds no results"),
        ("picture nowhere", "nowhere: no such folder"),
        ("models nowhere.safetensors", "nowhere.safetensors: no such file"),
        ("import-weights nowhere w.safetensors", "nowhere: cannot be read"),
        ("predict empty --weights rubbish.safetensors", "rubbish.safetensors"),
    ):
        result = run(*(word.format(weights=weights) for word in line.split()))
        assert result.exit_code == 1, result.output
        assert result.stdout == ""
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
        assert says in result.stderr


def test_folders_from_the_environment(run, data, weights, tmp_path, monkeypatch):
    monkeypatch.setenv("SALSANEXT_DATASET", str(data))
    monkeypatch.setenv("SALSANEXT_OUT", str(tmp_path / "from environment"))
    assert run("predict", "--weights", weights, "--split", "valid").exit_code == 0
    assert len(labels_below(tmp_path / "from environment")) == 2
    assert run("eval", "-q").exit_code == 0
    assert run("export-ply", "-q").exit_code == 0


def test_file_names_that_are_not_text(run, weights, tmp_path):
    folder = write_sequence(tmp_path / "Stra\udcdfe 1", ["Fahrt \udcfc"])
    out = tmp_path / "out"
    result = run("predict", folder, out, "--weights", weights, "--json")
    assert result.exit_code == 0, result.output
    assert only_json(result)["done"] == 1
    result = run("eval", "--out", out)
    assert result.exit_code == 0, result.output
    (folder / "velodyne/Fahrt \udcfc.bin").write_bytes(b"1")
    result = run("predict", folder, out, "--weights", weights, "--overwrite", "--json")
    assert result.exit_code == 1
    (failure,) = only_json(result)["failures"]
    assert failure["scan"] == f"{tmp_path}/Stra\\xdfe 1/velodyne/Fahrt \\xfc.bin"


def test_models_lists_networks_and_describes_weights(run, weights, monkeypatch):
    # To count them all takes seconds, and is asked elsewhere.
    some = {name: stages.ARCHITECTURES[name] for name in ("salsanet", "salsanet-dilated")}
    monkeypatch.setattr(stages, "ARCHITECTURES", some)
    result = run("models", weights)
    assert result.exit_code == 0
    for figure in ("random", "6,582,612 (6.58 M)", "25.59 G", "(9.25 M)"):
        assert figure in result.stdout
    assert result.stdout.index("SHA-256") < result.stdout.index("6,582,612")
    assert re.search(r"salsanet-dilated\*?† ", result.stdout)
    assert "† the paper does not determine this network" in result.stdout
    found = only_json(run("models", weights, "--json"))
    assert found["models"][0]["parameters"] == 6_582_612
    assert found["models"][0]["paper"]["flops"] == "51.60"
    assert found["weights"][0]["classes"][1] == "car"
    assert found["weights"][0]["sha256"] == hashlib.sha256(weights.read_bytes()).hexdigest()


def test_import_weights_and_predict_with_them(run, data, weights, tmp_path):
    half = tmp_path / "half.safetensors"
    result = run("import-weights", weights, half, "--half", "--description", "kürzer", "--json")
    assert result.exit_code == 0, result.output
    found = only_json(result)
    assert found["description"] == "kürzer"
    assert found["bytes"] == half.stat().st_size
    assert run("import-weights", weights, half).exit_code == 1
    assert run("import-weights", weights, half, "--overwrite", "-q").exit_code == 0
    assert run("predict", data, tmp_path / "out", "--weights", half).exit_code == 0


def test_several_scans_and_globs(run, data, weights, tmp_path):
    scans = sorted((data / "sequences/08/velodyne").iterdir())
    options = ("--weights", weights, "--device", "cpu")
    assert run("predict", *scans, tmp_path / "out", *options).exit_code == 0
    assert len(labels_below(tmp_path / "out")) == 2
    assert run("project", *scans, tmp_path / "images", "--weights", weights).exit_code == 0
    without_out = run("predict", *scans, *options)
    assert without_out.exit_code == 2
    assert "000001.bin is a file (expected a folder for the results" in without_out.stderr
    write_sequence(tmp_path / "other")
    hidden = run("predict", scans[0], data / "sequences/08", tmp_path / "other", *options)
    assert hidden.exit_code == 1
    assert "holds scans" in hidden.stderr
    both = run("predict", scans[0], tmp_path / "out", "--fuse", "--objects", *options)
    assert (both.exit_code, "--fuse: with" in both.stderr) == (2, True)


def test_a_temperature_is_printed_and_stored(run, data, weights, tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "ARCHITECTURES", {})  # counting takes seconds
    target = tmp_path / "tuned.safetensors"
    arguments = ("tune", "temperature", data, target, "--weights", weights, "--device", "cpu")
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    lines = (line.split("│")[1:-1] for line in result.stdout.splitlines() if "│" in line)
    (_, *before), (_, *after) = ([cell.strip() for cell in line] for line in lines)
    assert before[0] == "1.0000"
    assert after[0] == f"{read_card(target).temperature:.4f}"
    assert float(after[1]) < float(before[1])
    summary, following = result.stderr.splitlines()[-2:]
    assert summary.endswith(f" points of 2 scans → {target}")
    assert following == f"next: salsanext predict SCANS OUT --weights {target}"
    assert "exists" in run(*arguments).stderr
    found = only_json(run(*arguments, "--overwrite", "--json", "--limit", 1))
    expected = {"stage": "tune temperature", "scans": 1, "weights": str(target)}
    assert found.items() >= expected.items()
    assert found["after"]["temperature"] == read_card(target).temperature
    assert f"{read_card(target).temperature:.4g}" in run("models", target).stdout
