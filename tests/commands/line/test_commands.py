# SPDX-License-Identifier: MIT
"""Results, messages and exit status of the commands."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import only_json, subject
from evaluation_runs import CAR, ROAD, World
from scans import SMALL, labels_below, make_scan, write_array, write_bin, write_sequence

from salsanext_cli.core.notices import log_once
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.runs.results.output_paths import output_path


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
        result = run(*arguments, "--json", status=0)
        printed = only_json(result)
        assert (printed["schema"], printed["stage"]) == (2, arguments[0])
    assert len(labels_below(out)) == 2
    assert labels_below(out) == labels_below(steps)
    for option in ("--objects", "--fuse"):
        refused = run("predict", steps, steps, option, "--json", *network, status=2)
        assert only_json(refused)["error"].startswith(f"{option}: range images do not contain")


def test_scans_are_drawn_before_any_result(run, data, tmp_path):
    look, out = tmp_path / "look", tmp_path / "out"
    columns = ("--columns", "x,y,z,intensity", "--limit", 1)
    drawn = run("picture", data, look, *columns, status=0)
    lines = drawn.stderr.splitlines()
    assert any(
        re.match(r"colours: height -?[\d.]+ to .* m; intensity .*; range ", s) for s in lines
    )
    named = "--columns x,y,z,intensity"
    assert lines[-1] == f"next: salsanext predict {data} {look} {named}"
    printed = only_json(run("picture", data, out, "--colour", "height", "--json", status=0))
    assert (printed["done"], list(printed["scales"])) == (2, ["height"])
    assert Path(printed["first"]).read_bytes() == b"picture"


def test_pictures_state_the_values_of_their_scans_and_the_scale(run, data, tmp_path):
    first, second = sorted((data / "sequences/08/velodyne").iterdir())[:2]
    points = np.fromfile(second, np.float32).reshape(-1, 4)
    low, high = np.percentile(points[:, 2], [1, 99])
    points[:, 3] = 0
    points.tofile(second)
    run("picture", first, tmp_path / "out", status=0)
    drawn = run("picture", second, tmp_path / "out", status=0)
    line = next(s for s in drawn.stderr.splitlines() if s.startswith("colours: "))
    height, intensity = line.split("; ")[:2]
    assert re.search(rf"height {low:.3g} to {high:.3g} m \(scale -\S+ to \S+ m\)$", height)
    assert re.fullmatch(r"intensity 0 at most points \(scale 0\S* to \S+\)", intensity)


def test_the_picture_that_is_named_is_that_of_a_scan_that_did_not_fail(run, data, tmp_path):
    (data / "sequences/08/velodyne/000000.bin").write_bytes(b"x")
    printed = only_json(run("picture", data, tmp_path / "out", "--json", status=1))
    assert Path(printed["first"]).name == "000001.png"
    assert Path(printed["first"]).exists()


def test_options_of_scans_are_refused_for_results(run, results, data):
    run("picture", results, status=0)
    for option in (("--columns", "x,y,z"), ("--origin", "0,0,1"), ("--sensor", "hdl64")):
        refused = run("picture", results, *option)
        assert (refused.exit_code, subject(refused)) == (2, option[0])
    refused = run("picture", results, data)
    assert (refused.exit_code, subject(refused)) == (2, "OUT")


def test_runs_are_compared_with_the_first(run, predict, results, tmp_path):
    others = [tmp_path / name for name in ("second", "third")]
    for other, k in zip(others, (1, 5), strict=True):
        assert predict(other, "--knn-k", k).exit_code == 0
    compared = run("compare", results, *others, "--json", status=0)
    first, second = only_json(compared)["comparisons"]
    assert [run["after"] for run in (first, second)] == [str(other) for other in others]
    assert (first["scans"], second["agreement"]) == (2, 1)
    assert first["agreement"] < 1
    printed = run("compare", results, others[0], status=0)
    assert "accuracy" in printed.stdout
    assert printed.stderr.splitlines()[-1].startswith(f"compare: 2 scans → {others[0]}/")
    refused = run("compare", results, results)
    assert (refused.exit_code, subject(refused)) == (2, str(results))
    scan = sorted(others[0].rglob("*.label"))[0].relative_to(others[0])
    for folder in (results, others[0]):
        (folder / scan).unlink()
    incomplete = run("compare", results, others[0], "--json", status=1)
    (comparison,) = only_json(incomplete)["comparisons"]
    assert comparison["missing"] == [f"{scan.parts[1]}/{scan.stem}"]


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
    named = ("--sensor", sensor, "--columns", "Intensity, _, x, y, z")
    fitted = tmp_path / "fitted.toml"
    for arguments in (
        ("inspect", data, *named, "--fit", fitted),
        ("predict", data, out, *network, *named),
        ("uncertainty", data, out, "--samples", 2, *network, *named),
        ("eval", out, "--by-distance"),
        ("export-ply", out, "--color", "range"),
        ("project", data, steps, *named),
        ("predict", steps, steps, *network, "--sensor", sensor),
        ("knn-refine", steps),
        ("knn-refine", steps, "--overwrite", "--dataset", data, *named),
    ):
        run(*arguments, status=0)
    for refined in (out, steps):
        assert labels_below(refined) == labels_below(plain)
    assert 'columns = ["intensity", "_", "x", "y", "z"]' in fitted.read_text()
    wrong = run("predict", data, out, *network, "--columns", "x,y")
    assert wrong.exit_code == 2
    assert subject(wrong) == "--columns"


def test_messages_go_to_stderr(predict, weights, tmp_path):
    out = tmp_path / "out"
    first = predict(out)
    assert first.stdout == ""
    lines = [re.sub(r"[\d.]+ m?s\b", "T", line) for line in first.stderr.splitlines()]
    lines = [line for line in lines if not line.startswith(("warning", "hint"))]
    assert lines.pop(0).startswith("own vehicle not searched for in 2 scans: ")
    assert lines[1] == f"predict: 2 scans in T, T per scan → {out}"
    assert lines[2].startswith("image: 16×128, ")
    assert re.fullmatch(r"largest classes: (\S+ \d+\.\d %(, |$)){5}", lines[3])
    assert lines[4:] == [f"next: salsanext eval {out}"]
    again = predict(out, "-v")
    assert again.exit_code == 0
    assert re.search(rf"\npredict: 0 scans, 2 done already in .+ → {out}\n", again.stderr)
    assert "classes" not in again.stderr
    assert "08/000000: done" in predict(out, "--overwrite", "--verbose").stderr


def test_a_run_that_continues_says_that_its_lines_are_about_the_new_scans(predict, tmp_path):
    predict(tmp_path / "out", "--limit", 1)
    continued = predict(tmp_path / "out").stderr.splitlines()
    headline = next(n for n, line in enumerate(continued) if line.startswith("predict: 1 scan, 1"))
    assert continued[headline + 1] == "of the 1 new scan:"
    assert continued[headline + 2].startswith("image: ")


def test_quiet_prints_errors_only_and_failures_are_in_the_json(predict, data, tmp_path):
    result = predict(tmp_path / "out", "-q")
    assert (result.exit_code, result.output) == (0, "")
    (data / "sequences/08/velodyne/000001.bin").write_bytes(b"1")
    out = tmp_path / "other"
    result = predict(out, "--json", "--quiet")
    assert result.exit_code == 1
    assert Path(subject(result)).name == "000001.bin"
    printed = only_json(result)
    (failure,) = printed.pop("failures")
    expected = {"stage": "predict", "done": 1, "skipped": 0, "failed": 1, "out": str(out)}
    assert expected.items() <= printed.items()
    assert 0 < printed["seconds_per_scan"] <= printed["seconds"]
    assert 0 < sum(printed["largest_classes"].values()) <= 1
    assert Path(failure["scan"]).name == "000001.bin"
    assert failure["code"] == "format"
    assert result.stderr.splitlines()[0] == f"error: {failure['reason']}"


def test_eval_scores_the_uncertainty_again_when_it_changes(run, predict, data, weights, tmp_path):
    out = tmp_path / "out"
    predict(out, "--probabilities")
    sampled = ("uncertainty", data, out, "--weights", weights, "--device", "cpu")
    assert run(*sampled, "--samples", 2).exit_code == 0
    result = run("eval", out, status=0)
    assert "eval: 2 scans" in result.stderr
    assert (out / "scores.txt").exists()
    for word in ("car", "NLL", "least_confidence", "mutual_information", "AURC"):
        assert word in result.stdout
    report = json.loads((out / "eval.json").read_text("utf-8"))
    assert report["settings"]["uncertainty"]["samples"] == 2
    assert run(*sampled, "--samples", 3, "--overwrite").exit_code == 0
    assert run("eval", out).exit_code == 0
    report = json.loads((out / "eval.json").read_text("utf-8"))
    assert report["settings"]["uncertainty"]["samples"] == 3


def test_errors_of_points_are_evaluated(run, results):
    for stem in ("000000", "000001"):
        path = output_path(results, "08", "uncertainty/error", stem)
        write_array(path, np.linspace(0, 1, 1500, dtype=np.float32))
    result = run("eval", results, status=0)
    printed = " ".join(result.stdout.split())
    # A kind of uncertainty is called error; a line that begins with it would be a failure.
    assert not any(line.lower().startswith("error") for line in result.stdout.splitlines())
    assert only_json(run("eval", results, "--json"))["accepted"]["sentence"] in printed


def test_skipped_scans_are_no_failure_but_missing_results_are(run, predict, results, tmp_path):
    assert predict(tmp_path / "one", "--limit", 1).exit_code == 0
    (results / "sequences/08/predictions/000001.label").unlink()
    for command in ("eval", "export-ply"):
        result = run(command, tmp_path / "one", "--json", status=0)
        assert "(not part of the run: 1 other scan)" in result.stderr
        printed = only_json(result)
        assert (printed["missing"], printed["not_asked_for"]) == ([], 1)
        result = run(command, results, "-q", "--json")
        assert result.exit_code == 1
        assert result.stderr.startswith("error: ")
        assert [Path(path).name for path in only_json(result)["missing"]] == ["000001.bin"]


ON_DATA = "{data} other --weights {weights}"
TUNE = "tune dropout {data} other.safetensors --split valid --weights {weights}"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("export-ply --colour rainbow", "--colour"),
        ("picture --colour range --scale 2 1", "--scale"),
        ("picture --colour label --scale 1 2", "--scale"),
        (f"{TUNE} --samples 1", "--samples"),
        (f"predict {ON_DATA} --ego a,b,c,d,e,f", "--ego"),
        (f"predict {ON_DATA} --jobs 0", "--jobs"),
        (f"predict {ON_DATA} --limit 0", "--limit"),
        (f"predict {ON_DATA} --split tset", "split tset"),
        (f"predict {ON_DATA} --split valid --sequences 08", "--split and --sequences"),
        (f"predict {ON_DATA} --classes corse", "corse"),
        (f"predict {ON_DATA} --device cuda:99", "--device"),
        (f"uncertainty {ON_DATA} --samples 1", "--samples"),
        (f"predict {ON_DATA} --sequences ,", "--sequences"),
        ("knn-refine --label-space none.yaml", "none.yaml"),
        ("train {data} other --set epoch=3", "--set epoch=3"),
        ("import-weights {weights} other.safetensors --dropout 0.2", "--dropout"),
        (f"predict {ON_DATA} --fuse --reject 0.5", "--fuse"),
    ],
)
def test_wrong_settings_are_status_two(run, predicted, weights, monkeypatch, line, expected):
    monkeypatch.chdir(predicted.out.parent)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("SALSANEXT_OUT", str(predicted.out))
    names = {"data": predicted.data.name, "weights": weights}
    result = run(*(word.format(**names) for word in line.split()))
    assert (result.exit_code, subject(result)) == (2, expected.format(**names))
    assert not list(Path().glob("other*"))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("predict nowhere --weights {weights}", "nowhere"),
        ("eval empty", "empty"),
        ("picture nowhere", "nowhere"),
        ("models nowhere.safetensors", "nowhere.safetensors"),
        ("import-weights nowhere w.safetensors", "nowhere"),
        ("predict empty --weights rubbish.safetensors", "rubbish.safetensors"),
    ],
)
def test_nothing_to_work_on_is_status_one(run, weights, tmp_path, monkeypatch, line, expected):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "rubbish.safetensors").write_bytes(b"rubbish")
    result = run(*(word.format(weights=weights) for word in line.split()))
    assert (result.exit_code, result.stdout, subject(result)) == (1, "", expected)


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
    result = run("predict", folder, out, "--weights", weights, "--json", status=0)
    assert only_json(result)["done"] == 1
    result = run("eval", out, status=0)
    (folder / "velodyne/Fahrt \udcfc.bin").write_bytes(b"1")
    result = run("predict", folder, out, "--weights", weights, "--overwrite", "--json")
    assert result.exit_code == 1
    (failure,) = only_json(result)["failures"]
    assert failure["scan"] == f"{tmp_path}/Stra\\xdfe 1/velodyne/Fahrt \\xfc.bin"


def test_models_lists_networks_and_describes_weights(run, weights):
    result = run("models", weights, status=0)
    for text in ("random", "SHA-256", "networks: salsanext\n"):
        assert text in result.stdout
    printed = only_json(run("models", weights, "--json"))
    assert printed["models"] == ["salsanext"]
    assert printed["weights"][0]["classes"][1] == "car"
    assert printed["weights"][0]["sha256"] == hashlib.sha256(weights.read_bytes()).hexdigest()


def test_import_weights_and_predict_with_them(run, data, weights, tmp_path):
    half = tmp_path / "half.safetensors"
    described = ("--half", "--description", "kürzer", "--json")
    printed = only_json(run("import-weights", weights, half, *described, status=0))
    assert printed["description"] == "kürzer"
    assert printed["bytes"] == half.stat().st_size
    assert run("import-weights", weights, half).exit_code == 1
    assert run("import-weights", weights, half, "--overwrite", "-q").exit_code == 0
    assert run("predict", data, tmp_path / "out", "--weights", half).exit_code == 0


def test_splits_without_names_are_said_once(run, tmp_path, weights):
    write_sequence(tmp_path / "data/sequences/x1", ["000000", "000001"])
    run("predict", tmp_path / "data", tmp_path / "out", "--weights", weights, status=0)
    for limit in ((), ("--limit", 1)):
        result = run("eval", tmp_path / "out", "--split", "valid", *limit, status=0)
        assert result.stderr.count("no split names x1") == 1


def test_several_scans_and_globs(run, data, weights, tmp_path):
    scans = sorted((data / "sequences/08/velodyne").iterdir())
    options = ("--weights", weights, "--device", "cpu")
    assert run("predict", *scans, tmp_path / "out", *options).exit_code == 0
    assert len(labels_below(tmp_path / "out")) == 2
    assert run("project", *scans, tmp_path / "images", "--weights", weights).exit_code == 0
    without_out = run("predict", *scans, *options)
    assert (without_out.exit_code, subject(without_out)) == (2, "OUT")
    write_sequence(tmp_path / "other")
    hidden = run("predict", scans[0], data / "sequences/08", tmp_path / "other", *options)
    assert (hidden.exit_code, subject(hidden)) == (1, str(tmp_path / "other"))


def test_a_temperature_is_printed_and_stored(run, data, weights, tmp_path, monkeypatch):
    target = tmp_path / "tuned.safetensors"
    arguments = ("tune", "temperature", data, target, "--weights", weights, "--device", "cpu")
    result = run(*arguments, status=0)
    lines = (line.split("│")[1:-1] for line in result.stdout.splitlines() if "│" in line)
    (_, *before), (_, *after) = ([cell.strip() for cell in line] for line in lines)
    assert before[0] == "1.0000"
    assert after[0] == f"{read_card(target).temperature:.4f}"
    assert float(after[1]) < float(before[1])
    summary, following = result.stderr.splitlines()[-2:]
    assert summary.endswith(f" points of 2 scans → {target}")
    assert following == f"next: salsanext predict SCANS OUT --weights {target}"
    assert subject(run(*arguments)) == str(target)
    printed = only_json(run(*arguments, "--overwrite", "--json", "--subset", 1))
    expected = {"stage": "tune temperature", "scans": 1, "weights": str(target)}
    assert printed.items() >= expected.items()
    assert printed["after"]["temperature"] == read_card(target).temperature
    assert f"{read_card(target).temperature:.4g}" in run("models", target).stdout


def test_results_beside_their_scans_are_announced(run, weights, tmp_path):
    write_bin(tmp_path / "drive/0.bin", make_scan())
    words = ("--weights", weights)
    for out in (tmp_path / "drive/results", tmp_path / "drive"):
        result = run("project", tmp_path / "drive", out, *words, status=0)
        assert any(line.startswith(f"{out}: is ") for line in result.stderr.splitlines())
    apart = tmp_path / "apart"
    result = run("project", tmp_path / "drive", apart, *words, status=0)
    assert not any(line.startswith(f"{apart}: is ") for line in result.stderr.splitlines())


def test_notes_about_files_are_printed_by_the_command_that_reads_them_first(run, weights, tmp_path):
    drive = tmp_path / "drive"
    drive.mkdir()
    scan = make_scan()
    table = np.column_stack([scan.points, scan.intensity]).T
    np.save(drive / "0.npy", np.ascontiguousarray(table))
    out = tmp_path / "out"
    note = "are transposed to (N, columns)"
    log_once.cache_clear()
    assert note in run("predict", drive, out, "--weights", weights, status=0).stderr
    for words in (["export-ply", out], ["picture", out, "--colour", "label"]):
        log_once.cache_clear()
        assert note not in run(*words, status=0).stderr
    log_once.cache_clear()
    assert note in run("export-ply", out, "--colour", "range", "--verbose", status=0).stderr


def test_a_run_without_results_leaves_no_folder_and_no_record(run, weights, tmp_path):
    """The hint about the columns of a file can be followed into the same folder."""
    points = np.random.default_rng(0).uniform(-20, 20, (1501, 5)).astype(np.float32)
    path = tmp_path / "drive/0.bin"
    path.parent.mkdir()
    path.write_bytes(points.tobytes()[:-2])
    out = tmp_path / "new/out"
    words = ("--weights", weights)
    for command in ("predict", "uncertainty", "project"):
        assert run(command, path, out, *words).exit_code == 1
        assert not out.parent.exists()
    assert run("pick", path, out, *words).exit_code == 1
    assert not out.parent.exists()
    mine = tmp_path / "mine"
    mine.mkdir()
    assert run("predict", path, mine, *words).exit_code == 1
    assert [*mine.iterdir()] == []
    # The record of an earlier run stays.
    write_bin(tmp_path / "drive/1.bin", make_scan())
    assert run("predict", path.parent, mine, *words).exit_code == 1
    before = (mine / "predict.json").read_bytes()
    assert run("predict", path, mine, *words).exit_code == 1
    assert (mine / "predict.json").read_bytes() == before


def test_inspect_prints_no_tables_of_nothing(run, tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("my notes\nof today\n")
    result = run("inspect", notes, status=1)
    assert result.stdout == ""
    assert "'my notes'" in result.stderr


def test_report_writes_to_a_file_and_opens_it(run, tmp_path, monkeypatch):
    world = World(tmp_path)
    world.add("000000", [ROAD, ROAD], [ROAD, CAR])
    opened = []
    monkeypatch.setattr("typer.launch", lambda url: opened.append(url) or 0)
    page = tmp_path / "page.html"
    command = ("report", world.out, "--dataset", world.dataset, "-o", page)
    run(*command, status=0)
    assert opened == []
    run(*command, "--open", "--overwrite", status=0)
    assert opened == [page.as_uri()]
