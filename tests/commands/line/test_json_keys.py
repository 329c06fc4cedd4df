# SPDX-License-Identifier: MIT
"""The page on JSON lists every key; `only_json` compares the keys of the results of all tests."""

import json
import re

import pytest
from command_line import PAGE_OF_JSON, documented_keys, every_command, only_json
from quick_streets import record

from salsanext_cli.commands.stages import synth
from salsanext_cli.core.measures.expected_accuracy import expected_accuracy
from salsanext_cli.io.weights.card_file import default_weights, read_card

NETWORK = ("--weights", "WEIGHTS", "--device", "cpu")


def test_the_page_has_every_command():
    assert {name for name in every_command() if not documented_keys(name)} == set()


@pytest.mark.usefixtures("in_few_steps")
@pytest.mark.parametrize(
    "words",
    [
        ("tune", "error", "DATA", "NEW", *NETWORK),
        ("tune", "temperature", "DATA", "NEW", *NETWORK),
        ("tune", "risk", "DATA", "NEW", "--at-most", "90%", *NETWORK),
        ("tune", "dropout", "DATA", "NEW", "--samples", "2", *NETWORK),
        ("tune", "int8", "DATA", "NEW", "--weights", "WEIGHTS"),
        ("inspect", "DATA"),
        ("synth", "FOLDER", "--train", "0", "--valid", "1", "--scans", "1"),
    ],
    ids=lambda words: " ".join(word for word in words[:2] if word.islower()),
)
def test_keys_of_results_are_listed(run, data, weights, tmp_path, monkeypatch, words):
    monkeypatch.setattr(synth, "record", record)
    places = {
        "DATA": data,
        "WEIGHTS": weights,
        "NEW": tmp_path / "new.safetensors",
        "FOLDER": tmp_path / "new",
    }
    result = only_json(run(*(places.get(word, word) for word in words), "--json", status=0))
    assert result["stage"] == " ".join(word for word in words[:2] if word.islower())


def test_all_keys_of_eval_are_present_without_probabilities(run, data, weights, tmp_path):
    out = tmp_path / "out"
    run("predict", data, out, "--weights", weights, "--device", "cpu", status=0)
    only_json(run("report", out, "--json", status=0))
    evaluated = only_json(run("eval", out, "--json", status=0))
    table = PAGE_OF_JSON.read_text("utf-8").partition("\n## eval\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    listed = {key for row in rows for key in re.findall(r"`(\w+)`", row)}
    assert listed - {*evaluated} == set()
    assert (evaluated["calibration"], evaluated["rejection"]) == (None, None)


def test_the_interval_of_the_example_is_as_wide_as_one_of_the_default_weights():
    example = re.search(r'"expected_accuracy": (\{.*?\}\})', PAGE_OF_JSON.read_text("utf-8"))[1]
    stated = json.loads(example)
    line = read_card(default_weights()).accuracy
    estimates = [expected_accuracy(line, {"a": share / 1000}, {}) for share in range(500, 1000)]
    nearest = min(estimates, key=lambda estimate: abs(estimate.accuracy - stated["accuracy"]))
    assert stated["interval"] == pytest.approx(nearest.interval, abs=0.01)
