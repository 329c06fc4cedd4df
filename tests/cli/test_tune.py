# SPDX-License-Identifier: MIT
"""What `salsanext tune` does with what is typed."""

from pathlib import Path

import numpy as np
import pytest
from command_line import only_json

from salsanext_cli.network.weights import read_card
from salsanext_cli.stages.tune_batchnorm import SHARE
from salsanext_cli.storage.selection import ScanSelection

UPS = [f"up{i}" for i in range(1, 5)]


def test_a_temperature_is_printed_and_stored(run, data, weights, tmp_path):
    target = tmp_path / "tuned.safetensors"
    arguments = ("tune", "temperature", data, target, "--weights", weights, "--device", "cpu")
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    rows = [line.split("│")[1:-1] for line in result.stdout.splitlines() if "│" in line]
    (_, *before), (_, *after) = ([cell.strip() for cell in row] for row in rows)
    assert before[0] == "1.0000"
    assert after[0] == f"{read_card(target).temperature:.4f}"
    assert float(after[1]) < float(before[1])
    assert result.stderr.endswith(f" points of 2 scans → {target}\n")
    assert "exists" in run(*arguments).stderr
    found = only_json(run(*arguments, "--overwrite", "--json", "--limit", 1))
    assert (found["stage"], found["scans"], found["weights"]) == (
        "tune temperature",
        1,
        str(target),
    )
    assert found["after"]["temperature"] == read_card(target).temperature
    assert set(found["before"]) == {"temperature", "nll", "ece"}
    shown = only_json(run("models", target, "--json"))["weights"][0]
    assert shown["temperature"] == read_card(target).temperature
    assert f"{shown['temperature']:.4g}" in run("models", target).stdout


def test_batch_norm_is_adapted_to_scans_without_labels(run, data, weights, tmp_path):
    target = tmp_path / "adapted.safetensors"
    scans = data / "sequences/08/velodyne"
    arguments = ("tune", "batchnorm", scans, target, "--weights", weights, "--device", "cpu")
    result = run(*arguments, "--limit", 1)
    assert result.exit_code == 0, result.output
    rows = [line.split("│")[1:-1] for line in result.stdout.splitlines() if "│" in line]
    parts = {name.strip(): [float(cell) for cell in cells] for name, *cells in rows}
    assert list(parts) == ["context", *(f"block{i}" for i in range(1, 6)), *UPS, "all"]
    layers = sum(count for name, (count, *_) in parts.items() if name != "all")
    assert layers == parts["all"][0] == 42
    assert result.stderr == f"tune batchnorm: 1 scans of small → {target}\n"
    assert "exists" in run(*arguments).stderr
    same = only_json(run(*arguments, "--overwrite", "--json", "--limit", 1))["layers"]
    context = [layer for layer in same if layer["layer"].startswith("context.")]
    for name, layers in (("context", context), ("all", same)):
        shift = np.mean([layer["shift"] for layer in layers])
        ratio = np.exp(np.mean(np.log([layer["variance_ratio"] for layer in layers])))
        assert parts[name] == pytest.approx([len(layers), shift, ratio], abs=6e-4)
    found = only_json(run(*arguments, "--overwrite", "--json", "--share", 0.25))
    assert (found["stage"], found["scans"], found["share"]) == ("tune batchnorm", 2, 0.25)
    assert (found["sensor"], found["weights"]) == ("small", str(target))
    assert found["layers"][0].keys() == {"layer", "shift", "variance_ratio"}
    assert len(found["layers"]) == 42
    assert "share 0.25" in only_json(run("models", target, "--json"))["weights"][0]["description"]


def test_settings_of_batch_norm_reach_the_stage(run, weights, monkeypatch):
    seen = {}

    class Stop(Exception):  # noqa: N818
        pass

    def stage(source, target, **settings):
        seen.update(settings, source=source, target=target)
        raise Stop

    monkeypatch.setattr("salsanext_cli.stages.tune_batchnorm.tune_batchnorm", stage)
    run("tune", "batchnorm", "scans", "w.safetensors")
    assert (seen["source"], seen["target"]) == (Path("scans"), Path("w.safetensors"))
    assert seen["selection"] == ScanSelection()
    assert seen["share"] == SHARE
    assert not seen["overwrite"]
    network = ("--weights", weights, "--sensor", "hdl32", "--device", "cpu")
    chosen = ("--split", "test", "--limit", 7, "--share", 0.9, "--overwrite", "-q")
    result = run("tune", "batchnorm", "scans", "w.safetensors", *network, *chosen)
    assert isinstance(result.exception, Stop)
    assert seen["selection"] == ScanSelection(split="test", limit=7)
    assert (seen["share"], seen["overwrite"], seen["progress"]) == (0.9, True, None)
    used = seen["network"]
    assert (used.weights, used.sensor.name, used.device) == (weights, "hdl32", "cpu")


@pytest.mark.parametrize(
    ("share", "status", "says"),
    [("0", 2, "--share · 0 · expected"), ("1.5", 2, "--share · 1.5"), ("nan", 2, "--share · nan")],
)
def test_shares_that_are_none(run, data, weights, tmp_path, share, status, says):
    target = tmp_path / "w.safetensors"
    result = run("tune", "batchnorm", data, target, "--weights", weights, "--share", share)
    assert result.exit_code == status, result.output
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert not target.exists()


def test_settings_reach_the_stage(run, weights, monkeypatch):
    seen = {}

    class Stop(Exception):  # noqa: N818
        pass

    def stage(dataset, target, **settings):
        seen.update(settings, dataset=dataset, target=target)
        raise Stop

    for name, module in (("temperature", "tune_temperature"), ("dropout", "tune_dropout")):
        monkeypatch.setattr(f"salsanext_cli.stages.{module}.{module}", stage)
        common = ("--sequences", "00", "--limit", 7, "--weights", weights, "--sensor", "hdl32")
        result = run("tune", name, "data", "w.safetensors", *common, "--overwrite", "-q")
        assert isinstance(result.exception, Stop)
        assert (seen["dataset"], seen["target"]) == (Path("data"), Path("w.safetensors"))
        selection, network = seen["selection"], seen["network"]
        assert (selection.split, selection.sequences, selection.limit) == (None, ("00",), 7)
        assert (network.weights, network.sensor.name) == (weights, "hdl32")
        assert seen["overwrite"]
        run("tune", name, "data", "w.safetensors")
        assert seen["selection"].split == "valid"
        run("tune", name, "data", "w.safetensors", "--split", "train")
        assert seen["selection"].split == "train"
    assert seen["selection"].limit == 20
    numbers = ("--samples", 4, "--seed", 3, "--lowest", 0.1, "--highest", 0.3, "--steps", 5)
    run("tune", "dropout", "data", "w.safetensors", *numbers)
    names = ("samples", "seed", "lowest", "highest", "steps")
    assert [seen[name] for name in names] == [4, 3, 0.1, 0.3, 5]


@pytest.mark.parametrize("what", ["temperature", "dropout", "batchnorm"])
@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["--limit", "0"], 2, "--limit · 0 · expected at least 1"),
        (["--split", "tset"], 2, "split tset · no such split"),
        (["--split", "valid", "--sequences", "08"], 2, "both given"),
        (["--split", "test"], 1, "no scans of split test"),
        (["--sequences", "77"], 1, "no scans of sequence 77"),
        (["--device", "cuda:99"], 2, "device cuda:99"),
        (["--weights", "none.safetensors"], 1, "none.safetensors · no such file"),
        (["--verbose", "--quiet"], 2, "both given"),
    ],
)
def test_settings_that_are_none(run, data, weights, tmp_path, what, arguments, status, says):
    target = tmp_path / "tuned.safetensors"
    network = () if "--weights" in arguments else ("--weights", weights)
    result = run("tune", what, data, target, *network, *arguments)
    assert result.exit_code == status, result.output
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert not target.exists()


@pytest.mark.parametrize("what", ["temperature", "dropout"])
def test_data_that_cannot_be_learnt_from(run, data, weights, tmp_path, what):
    (tmp_path / "empty").mkdir()
    (data / "sequences/08/labels/000001.label").unlink()
    for dataset, says in ((data, "000001.label · no such file"), ("empty", "empty · ")):
        result = run("tune", what, dataset, tmp_path / "w.safetensors", "--weights", weights)
        assert result.exit_code == 1, result.output
        assert says in result.stderr
        assert result.stderr.count("\n") == 1


def test_scans_that_batch_norm_cannot_be_adapted_to(run, data, weights, tmp_path):
    (tmp_path / "empty").mkdir()
    (data / "sequences/08/velodyne/000001.bin").write_bytes(b"no point")
    for source, says in ((data, "000001.bin · "), (tmp_path / "empty", "empty · ")):
        target = tmp_path / "w.safetensors"
        result = run("tune", "batchnorm", source, target, "--weights", weights)
        assert result.exit_code == 1, result.output
        assert says in result.stderr
        assert result.stderr.count("\n") == 1
        assert not target.exists()


@pytest.mark.parametrize("what", ["temperature", "dropout", "batchnorm"])
def test_targets_that_cannot_be_written(run, data, weights, tmp_path, what):
    (tmp_path / "file").touch()
    for target, says in (("w.pt", "suffix .pt"), ("file/w.safetensors", "cannot be written")):
        result = run("tune", what, data, tmp_path / target, "--weights", weights)
        assert result.exit_code == 1, result.output
        assert says in result.stderr
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
