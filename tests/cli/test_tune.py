# SPDX-License-Identifier: MIT
"""`salsanext tune`: results, messages, settings."""

from pathlib import Path

import pytest
from command_line import only_json

from salsanext_cli.network.card import read_card
from salsanext_cli.options import ScanSelection


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
    [("temperature", "valid", None), ("dropout", "valid", 20)],
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
