# SPDX-License-Identifier: MIT
"""What commands do with what is typed: results, talk, exit status."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import only_json
from scans import labels_below, write_sequence

from salsanext_cli.errors import SalsanextError
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.parallel.run import Outcome


@pytest.fixture
def predicted(run, data, weights, tmp_path):
    """Return an output folder with predictions."""
    out = tmp_path / "out"
    assert run("predict", data, out, "--weights", weights, "--device", "cpu").exit_code == 0
    return out


def test_project_predict_refine(run, data, weights, tmp_path):
    out = tmp_path / "out"
    sensor = tmp_path / "small.toml"
    sensor.write_text("fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 128\n")
    for arguments in (
        ("project", data, out, "--sensor", sensor),
        ("predict", out, out, "--weights", weights),
        ("knn-refine", out),
        ("predict", data, tmp_path / "fused", "--weights", weights),
    ):
        result = run(*arguments)
        assert result.exit_code == 0, result.output
        assert result.stdout == ""
    assert labels_below(out) == labels_below(tmp_path / "fused")
    assert len(labels_below(out)) == 2


def test_talk_goes_to_stderr(run, data, weights, tmp_path):
    out = tmp_path / "out"
    first = run("predict", data, out, "--weights", weights)
    assert first.stdout == ""
    assert first.stderr == f"{weights} on cpu in float32\npredict: 2 scans → {out}\n"
    again = run("predict", data, out, "--weights", weights)
    assert again.exit_code == 0
    assert again.stderr.endswith(f"\npredict: 0 scans, 2 done already → {out}\n")


@pytest.mark.parametrize("flag", ["-q", "--quiet"])
def test_quiet_is_silent(run, data, weights, tmp_path, flag):
    result = run("predict", data, tmp_path / "out", "--weights", weights, flag)
    assert (result.exit_code, result.output) == (0, "")


def test_quiet_still_says_what_went_wrong(run, data, weights, tmp_path):
    (data / "sequences/08/velodyne/000001.bin").write_bytes(b"1")
    result = run("predict", data, tmp_path / "out", "--weights", weights, "-q")
    assert result.exit_code == 1
    assert len(result.stderr.splitlines()) == 1
    assert "000001.bin · 1 bytes" in result.stderr


def test_verbose_names_scans(run, data, weights, tmp_path):
    result = run("predict", data, tmp_path / "out", "--weights", weights, "-v")
    assert "08/000000: done" in result.stderr


def test_json_is_one_object_and_nothing_else(run, data, weights, tmp_path):
    out = tmp_path / "out"
    (data / "sequences/08/velodyne/000001.bin").write_bytes(b"1")
    result = run("predict", data, out, "--weights", weights, "--json")
    found = only_json(result)
    failures = found.pop("failures")
    assert found == {"stage": "predict", "done": 1, "skipped": 0, "failed": 1, "out": str(out)}
    assert failures[0]["scan"].endswith("000001.bin")
    assert "1 bytes" in failures[0]["reason"]
    assert result.exit_code == 1


def test_json_of_every_stage(run, data, weights, tmp_path):
    out, network = tmp_path / "out", ("--weights", weights, "--device", "cpu")
    sensor = tmp_path / "small.toml"
    sensor.write_text("fov_up = 3.0\nfov_down = -25.0\nheight = 16\nwidth = 128\n")
    calls = {
        "project": ("project", data, tmp_path / "p", "--sensor", sensor),
        "predict": ("predict", data, out, *network),
        "uncertainty": ("uncertainty", data, out, "--samples", 2, *network),
        "eval": ("eval", "--out", out),
        "export-ply": ("export-ply", "--out", out, "--colour", "error"),
    }
    for stage, arguments in calls.items():
        result = run(*arguments, "--json")
        assert result.exit_code == 0, result.output
        assert only_json(result)["stage"] == stage


def test_eval_prints_a_table_and_writes_scores(run, predicted):
    result = run("eval", "--out", predicted, "--split", "valid")
    assert result.exit_code == 0
    assert "car" in result.stdout
    assert "mean" in result.stdout.lower()
    assert (predicted / "scores.txt").exists()
    assert "eval: 2 scans" in result.stderr
    again = ("eval", "--out", predicted, "--split", "valid", "--json")
    assert only_json(run(*again))["scans"] == 2


def test_eval_with_other_settings_needs_overwrite(run, predicted, data, weights):
    assert run("eval", "--out", predicted, "--limit", 1).exit_code == 0
    before = (predicted / "eval.json").read_bytes()
    for other in ((), ("--limit", 2), ("--limit", 1, "--by-distance"), ("--dataset", data)):
        result = run("eval", "--out", predicted, *other)
        assert result.exit_code == 1
        assert "eval.json · made with other settings" in result.stderr
        assert result.stderr.count("\n") == 1
    assert (predicted / "eval.json").read_bytes() == before
    assert run("eval", "--out", predicted, "--overwrite").exit_code == 0
    knn = ("--knn-k", 3, "--overwrite", "--weights", weights, "--device", "cpu")
    assert run("predict", data, predicted, *knn).exit_code == 0
    result = run("eval", "--out", predicted)
    assert result.exit_code == 1
    assert "what `predict` made was made anew" in result.stderr


def test_eval_prints_what_uncertainty_is_worth(run, data, weights, tmp_path):
    out, network = tmp_path / "out", ("--weights", weights, "--device", "cpu")
    run("predict", data, out, "--probabilities", *network)
    run("uncertainty", data, out, "--samples", 2, *network)
    result = run("eval", "--out", out)
    assert result.exit_code == 0
    for word in ("NLL", "ECE per scan", "confidence", "mutual_information", "AUSE"):
        assert word in result.stdout
    found = only_json(run("eval", "--out", out, "--json"))
    assert found["calibration"]["scans"] == 2
    assert found["uncertainty"]["epistemic"]["scans"] == 2
    for name in ("reliability", "risk_coverage", "sparsification", "class_uncertainty"):
        assert (out / f"eval_{name}.png").exists()


def test_eval_without_labels(run, predicted, data):
    for path in (data / "sequences/08/labels").iterdir():
        path.unlink()
    (data / "sequences/08/labels").rmdir()
    result = run("eval", "--out", predicted)
    assert result.exit_code == 1
    assert "no labels of sequence 08" in result.stderr
    assert "Traceback" not in result.stderr


def test_eval_of_an_incomplete_run_is_status_one(run, predicted):
    (predicted / "sequences/08/predictions/000001.label").unlink()
    result = run("eval", "--out", predicted)
    assert result.exit_code == 1
    assert "1 of 2 scans have no predictions" in result.stderr


@pytest.mark.parametrize("command", ["eval", "export-ply"])
def test_scans_left_out_on_purpose_are_counted_and_no_failure(
    run, data, weights, tmp_path, command
):
    out = tmp_path / "out"
    network = ("--weights", weights, "--device", "cpu")
    assert run("predict", data, out, "--limit", 1, *network).exit_code == 0
    result = run(command, "--out", out)
    assert result.exit_code == 0, result.output
    assert f"{command}: 1 scans, 1 not asked for have no" in result.stderr
    assert "error" not in result.stderr
    found = only_json(run(command, "--out", out, "--json"))
    assert (found["missing"], found["not_asked_for"]) == ([], 1)


@pytest.mark.parametrize("command", ["eval", "export-ply"])
def test_scans_that_should_have_results_are_status_one(run, predicted, command):
    (predicted / "sequences/08/predictions/000001.label").unlink()
    result = run(command, "--out", predicted, "-q")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: 1 of 2 scans have no ")
    assert result.stderr.endswith("the first is 08/000001\n")
    found = only_json(run(command, "--out", predicted, "--json"))
    assert [Path(path).name for path in found["missing"]] == ["000001.bin"]
    assert run("export-ply", "--out", predicted, "--limit", 1).exit_code == 0


def test_eval_names_labels_of_another_number(run, predicted, data):
    path = data / "sequences/08/labels/000001.label"
    path.write_bytes(path.read_bytes()[:-4])
    result = run("eval", "--out", predicted)
    assert result.exit_code == 1
    assert "1499" in result.stderr
    assert len(json.loads((predicted / "eval.json").read_text())["failures"]) == 1


def test_export_takes_both_spellings(run, predicted):
    assert run("export-ply", "--out", predicted, "--color", "range").exit_code == 0
    result = run("export-ply", "--out", predicted, "--colour", "range")
    assert result.exit_code == 0
    assert "2 done already" in result.stderr
    given = run("export-ply", "--out", predicted, "--colour", "range", "--scale", 0, 20)
    assert given.exit_code == 1
    assert "scale was" in given.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["export-ply", "--colour", "rainbow"], "--colour · rainbow · expected one of label"),
        (["export-ply", "--colour", "range", "--scale", "nan", "1"], "--scale"),
        (["predict", "{data}", "--jobs", "0"], "--jobs · 0"),
        (["predict", "{data}", "--limit", "0"], "--limit · 0"),
        (["predict", "{data}", "--split", "tset"], "split tset · no such split"),
        (["predict", "{data}", "--split", "valid", "--sequences", "08"], "both given"),
        (["predict", "{data}", "--sensor", "hdl65"], "sensor hdl65"),
        (["predict", "{data}", "--device", "cuda:99"], "device cuda:99"),
        (["predict", "{data}", "--knn-window", "4"], "window 4"),
        (["predict", "{data}", "--knn-k", "30"], "k 30"),
        (["predict", "{data}", "--knn-cutoff", "nan"], "cutoff nan"),
        (["uncertainty", "{data}", "--samples", "1"], "--samples · 1 · expected at least 2"),
        (["uncertainty", "{data}", "--samples", "0"], "--samples · 0"),
        (["knn-refine", "--label-space", "none.yaml"], "none.yaml · no such file"),
        (["import-weights", "{weights}", "x.safetensors", "--verbose", "--quiet"], "both given"),
    ],
)
def test_settings_that_are_none_are_status_two(
    run, predicted, data, weights, tmp_path, monkeypatch, arguments, says
):
    monkeypatch.chdir(tmp_path)
    command = [text.format(data=data, weights=weights) for text in arguments]
    if command[0] in ("predict", "uncertainty"):
        command += ["other", "--weights", str(weights)]
        command += ["--device", "cpu"] if "--device" not in command else []
        command.insert(2, command.pop(-5 if "--device" in command[-2:] else -3))
    result = run(*command)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert says in result.stderr
    assert not Path("other").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["predict", "nowhere"], "nowhere · no such file"),
        (["predict", "empty"], "empty · holds no scans"),
        (["project", "empty", "--sensor", "hdl64"], "empty · holds no scans"),
        (["uncertainty", "empty"], "empty · holds no scans"),
        (["eval", "--out", "nowhere"], "nowhere · no such folder"),
        (["eval", "--out", "empty"], "empty · holds no results"),
        (["export-ply", "--out", "nowhere"], "nowhere · no such folder"),
        (["knn-refine", "nowhere"], "nowhere · no such folder"),
        (["models", "nowhere.safetensors"], "nowhere.safetensors · no such file"),
        (["import-weights", "nowhere", "w.safetensors"], "nowhere · cannot be read"),
        (["predict", "empty", "--weights", "rubbish.safetensors"], "rubbish.safetensors"),
    ],
)
def test_nothing_to_work_on_is_status_one(run, weights, tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "rubbish.safetensors").write_bytes(b"rubbish")
    if arguments[0] in ("predict", "uncertainty") and "--weights" not in arguments:
        arguments = [*arguments, "--weights", str(weights)]
    result = run(*arguments)
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert says in result.stderr
    assert "Traceback" not in result.output


def test_bugs_keep_their_traceback(run, data, weights, tmp_path, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("a bug of ours")

    monkeypatch.setattr("salsanext_cli.stages.predict.knn_refine", broken)
    result = run("predict", data, tmp_path / "out", "--weights", weights)
    assert isinstance(result.exception, ZeroDivisionError)


def test_ctrl_c_is_status_130(run, data, weights, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("salsanext_cli.stages.predict.knn_refine", interrupted)
    result = run("predict", data, tmp_path / "out", "--weights", weights)
    assert result.exit_code == 130
    assert result.stderr.splitlines()[1:] == ["interrupted: everything finished so far is intact"]


def test_on_error_stop(run, data, weights, tmp_path):
    (data / "sequences/08/velodyne/000000.bin").write_bytes(b"1")
    out = tmp_path / "out"
    result = run("predict", data, out, "--weights", weights, "--on-error", "stop", "--quiet")
    assert result.exit_code == 1
    assert result.stderr.startswith("error: ")
    assert labels_below(out) == {}
    assert run("predict", data, out, "--weights", weights).exit_code == 1
    assert len(labels_below(out)) == 1


def test_settings_reach_the_stage(run, data, weights, tmp_path, monkeypatch):
    """Every option of `predict` arrives where it counts."""
    seen = {}

    def stage(source, out, **settings):
        seen.update(settings, source=source, out=out)
        return Outcome((None,), 0, ())

    monkeypatch.setattr("salsanext_cli.stages.predict.predict", stage)
    result = run(
        *("predict", "scans", "results", "--pixel-labels", "--probabilities"),
        *("--sequences", "00,08", "--limit", 7, "--weights", weights, "--device", "cpu"),
        *("--sensor", "hdl32", "--knn-k", 3, "--knn-window", 7, "--knn-sigma", 2),
        *("--knn-cutoff", 0.5, "-j", 2, "--overwrite", "--on-error", "stop"),
    )
    assert result.exit_code == 0, result.output
    assert (seen["source"], seen["out"]) == (Path("scans"), Path("results"))
    assert seen["extras"] == ("pixel_labels", "probabilities")
    assert (seen["choice"].sequences, seen["choice"].limit) == (("00", "08"), 7)
    network, knn, batch = seen["network"], seen["knn"], seen["options"]
    assert (network.weights, network.device, network.sensor.name) == (weights, "cpu", "hdl32")
    assert (knn.k, knn.window, knn.sigma, knn.cutoff) == (3, 7, 2.0, 0.5)
    assert (batch.jobs, batch.overwrite, batch.on_error) == (2, True, "stop")


def test_folders_from_the_environment(run, data, weights, tmp_path, monkeypatch):
    monkeypatch.setenv("SALSANEXT_DATASET", str(data))
    monkeypatch.setenv("SALSANEXT_OUT", str(tmp_path / "from environment"))
    assert run("predict", "--weights", weights, "--split", "valid").exit_code == 0
    assert len(labels_below(tmp_path / "from environment")) == 2
    assert run("eval", "-q").exit_code == 0
    assert run("export-ply", "-q").exit_code == 0


def test_without_scans_the_data_set_here(run, data, weights, monkeypatch):
    monkeypatch.chdir(data)
    assert run("predict", "--weights", weights).exit_code == 0
    assert len(labels_below(data / "out")) == 2


def test_names_that_are_no_text(run, weights, tmp_path):
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
    assert only_json(result)["failed"] == 1


def test_models_lists_networks_and_describes_weights(run, weights):
    result = run("models", weights)
    assert result.exit_code == 0
    assert "6,711,572" in result.stdout
    assert "62.30 G" in result.stdout
    assert "random" in result.stdout
    assert "salsanet-dilated† " in result.stdout
    assert "9,246,036 (9.25 M)" in result.stdout
    assert "359.71 G (720.96 G)" in result.stdout
    assert "† the paper does not determine this network" in result.stdout
    found = only_json(run("models", weights, "--json"))
    assert found["models"][0]["parameters"] == 6_711_572
    assert found["models"][0]["paper"]["flops"] == "125.68"
    assert found["weights"][0]["classes"][1] == "car"


def test_import_weights_and_predict_with_them(run, data, weights, tmp_path):
    half = tmp_path / "half.safetensors"
    result = run("import-weights", weights, half, "--half", "--description", "kürzer", "--json")
    assert result.exit_code == 0, result.output
    found = only_json(result)
    assert found["description"] == "kürzer"
    assert found["bytes"] == half.stat().st_size
    again = run("import-weights", weights, half)
    assert again.exit_code == 1
    assert "exists" in again.stderr
    assert run("import-weights", weights, half, "--overwrite", "-q").exit_code == 0
    assert run("predict", data, tmp_path / "out", "--weights", half).exit_code == 0


@pytest.mark.parametrize("option", [("--dropout", 0.2), ("--label-space", "semantic-kitti")])
def test_import_weights_takes_nothing_that_our_weights_say_themselves(
    run, weights, tmp_path, option
):
    result = run("import-weights", weights, tmp_path / "w.safetensors", *option)
    assert result.exit_code == 2
    assert f"{option[0]} · {weights} says for itself" in result.stderr
    assert f"leave {option[0]} out" in result.stderr
    assert not (tmp_path / "w.safetensors").exists()


def test_import_weights_of_a_checkpoint_that_runs_something(run, tmp_path):
    class Attack:
        def __reduce__(self):
            import os

            return os.mkdir, (str(tmp_path / "proof"),)

    torch.save({"state_dict": Attack()}, tmp_path / "bad")
    result = run("import-weights", tmp_path / "bad", tmp_path / "w.safetensors")
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "proof").exists()
    assert not (tmp_path / "w.safetensors").exists()


def test_refine_anybodys_labels(run, data, tmp_path):
    out = tmp_path / "out"
    result = run(
        "knn-refine",
        out,
        "--labels",
        data / "sequences/08/labels",
        "--dataset",
        data / "sequences/08",
    )
    assert result.exit_code == 0, result.output
    refined = read_labels(out / "sequences/08/predictions/000000.label")
    assert len(np.unique(refined)) > 5


def test_every_error_of_ours_can_be_shown():
    for kind in SalsanextError.__subclasses__():
        assert str(kind("a", "b", "c", "d")) == "a · b · expected c · d"


def test_eval_notices_that_uncertainties_were_made_anew(run, data, weights, tmp_path):
    out = tmp_path / "out"
    assert run("predict", data, out, "--weights", weights).exit_code == 0
    made = ("uncertainty", data, out, "--weights", weights)
    assert run(*made, "--samples", "2").exit_code == 0
    judged = ("eval", "--dataset", data, "--out", out)
    assert run(*judged).exit_code == 0
    report = json.loads((out / "eval.json").read_text("utf-8"))
    assert report["settings"]["uncertainty"]["method"] == "sampling"
    assert len(report["uncertainty"]["total"]["thresholds"]) == 100
    assert run(*made, "--method", "analytic", "--overwrite").exit_code == 0
    again = run(*judged)
    assert again.exit_code == 1
    assert "uncertainty" in again.output
    assert run(*judged, "--overwrite").exit_code == 0
