# SPDX-License-Identifier: MIT
"""`salsanext tune`: results, messages, settings."""

from command_line import only_json

from salsanext_cli.network.card import read_card
from salsanext_cli.stages import models


def rows_of(result):
    """Return the rows of a printed table."""
    lines = (line.split("│")[1:-1] for line in result.stdout.splitlines() if "│" in line)
    return [[cell.strip() for cell in line] for line in lines]


def test_a_temperature_is_printed_and_stored(run, data, weights, tmp_path, monkeypatch):
    monkeypatch.setattr(models, "ARCHITECTURES", {})  # counting takes seconds
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
