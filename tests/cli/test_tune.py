# SPDX-License-Identifier: MIT
"""`salsanext tune`: results, messages, settings."""

from pathlib import Path

import numpy as np
import pytest
from command_line import only_json

from salsanext_cli.network.card import read_card
from salsanext_cli.options import ScanSelection

UPS = [f"up{i}" for i in range(1, 5)]


def rows_of(result):
    """Return the rows of a printed table."""
    lines = (line.split("│")[1:-1] for line in result.stdout.splitlines() if "│" in line)
    return [[cell.strip() for cell in line] for line in lines]


def test_a_temperature_is_printed_and_stored(run, data, weights, tmp_path):
    target = tmp_path / "tuned.safetensors"
    arguments = ("tune", "temperature", data, target, "--weights", weights, "--device", "cpu")
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    (_, *before), (_, *after) = rows_of(result)
    assert before[0] == "1.0000"
    assert after[0] == f"{read_card(target).temperature:.4f}"
    assert float(after[1]) < float(before[1])
    assert result.stderr.endswith(f" points of 2 scans → {target}\n")
    assert "exists" in run(*arguments).stderr
    found = only_json(run(*arguments, "--overwrite", "--json", "--limit", 1))
    expected = {"stage": "tune temperature", "scans": 1, "weights": str(target)}
    assert found.items() >= expected.items()
    assert found["after"]["temperature"] == read_card(target).temperature
    assert f"{read_card(target).temperature:.4g}" in run("models", target).stdout


def test_batch_norm_is_adapted_to_scans_without_labels(run, data, weights, tmp_path):
    target = tmp_path / "adapted.safetensors"
    scans = data / "sequences/08/velodyne"
    arguments = ("tune", "batchnorm", scans, target, "--weights", weights, "--device", "cpu")
    result = run(*arguments, "--limit", 1)
    assert result.exit_code == 0, result.output
    parts = {name: [float(cell) for cell in cells] for name, *cells in rows_of(result)}
    assert list(parts) == ["context", *(f"block{i}" for i in range(1, 6)), *UPS, "all"]
    weights_said, done = result.stderr.splitlines()
    assert weights_said.endswith(" on cpu by torch in float32")
    assert done == f"tune batchnorm: 1 scan of small → {target}"
    assert "exists" in run(*arguments).stderr
    found = only_json(run(*arguments, "--overwrite", "--json", "--limit", 1, "--share", 0.1))
    expected = {"stage": "tune batchnorm", "scans": 1, "sensor": "small", "share": 0.1}
    assert found.items() >= {**expected, "weights": str(target)}.items()
    context = [layer for layer in found["layers"] if layer["layer"].startswith("context.")]
    for name, layers in (("context", context), ("all", found["layers"])):
        shift = np.mean([layer["shift"] for layer in layers])
        ratio = np.exp(np.mean(np.log([layer["variance_ratio"] for layer in layers])))
        assert parts[name] == pytest.approx([len(layers), shift, ratio], abs=6e-4)


@pytest.fixture
def typed(run, monkeypatch):
    """Return a function that gives what the stage of a tuning is called with."""

    def call(what, *arguments):
        seen = {}

        def stage(part, source, target, **settings):
            assert (part, source, target) == (what, Path("data"), Path("w.safetensors"))
            seen.update(settings)
            raise InterruptedError

        monkeypatch.setattr("salsanext_cli.stages.tune.tune", stage)
        result = run("tune", what, "data", "w.safetensors", *arguments)
        assert isinstance(result.exception, InterruptedError), result.output
        return seen

    return call


@pytest.mark.parametrize(
    ("what", "split", "limit"),
    [("temperature", "valid", None), ("dropout", "valid", 20), ("batchnorm", None, None)],
)
def test_settings_reach_the_stage(typed, weights, what, split, limit):
    seen = typed(what)
    assert seen["selection"] == ScanSelection(split=split, limit=limit)
    assert not seen["overwrite"]
    network = ("--weights", weights, "--sensor", "hdl32", "--device", "cpu")
    seen = typed(what, "--sequences", "00", "--limit", 7, *network, "--overwrite", "-q")
    assert seen["selection"] == ScanSelection(sequences=("00",), limit=7)
    assert (seen["overwrite"], seen["progress"]) == (True, None)
    used = seen["network"]
    assert (used.weights, used.sensor, used.device) == (weights, "hdl32", "cpu")
    assert typed(what, "--split", "train", "--limit", 1)["selection"].split == "train"


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["--limit", "0"], 2, "--limit · 0 · expected at least 1"),
        (["--split", "tset"], 2, "split tset · no such split"),
        (["--split", "test"], 1, "no scans of split test"),
        (["--sequences", "77"], 1, "no scans of sequence 77"),
        (["--weights", "none.safetensors"], 1, "none.safetensors · no such file"),
    ],
)
def test_wrong_settings_are_one_line(run, data, weights, tmp_path, arguments, status, says):
    target = tmp_path / "tuned.safetensors"
    network = () if "--weights" in arguments else ("--weights", weights)
    result = run("tune", "temperature", data, target, *network, *arguments)
    assert result.exit_code == status, result.output
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
    assert not target.exists()
