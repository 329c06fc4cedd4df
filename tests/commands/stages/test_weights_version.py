# SPDX-License-Identifier: MIT
"""Version of the default weights: where it is printed, and which files have none."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from evaluation_runs import run_of
from world import World

from salsanext_cli.commands.stages.import_weights import import_weights
from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.commands.stages.tune import tune_temperature
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.report.card_table import card_table
from salsanext_cli.runs.network_settings import NetworkSettings

TRAINED = "Trained on simulated scenes: 7 scans. Not for real roads."


@pytest.fixture
def default(narrow_default: Path) -> Path:
    """Have a version in the default weights."""
    card = replace(read_card(narrow_default), version=5, description=TRAINED)
    save_with_card(narrow_default, narrow_default, card)
    return narrow_default


def rows_of(path: Path) -> dict[str, str]:
    names, values = card_table(describe_weights(path)).columns
    return dict(zip(map(str, names.cells), map(str, values.cells), strict=True))


def test_a_run_prints_and_records_the_version(world: World, default: Path, caplog) -> None:
    caplog.set_level(NOTICE)
    settings = NetworkSettings(None, "cpu", engine="torch")
    predict_scans(world.data, world.out, settings=settings)
    name = f"default weights version 5 (SHA-256 {fingerprint(default)[:16]})"
    line = f"{name}, trained on simulated scenes, on cpu by torch in float32"
    assert [text for text in caplog.messages if "default" in text] == [line]
    recorded = json.loads((world.out / "predict.json").read_text())["settings"]
    assert recorded["weights_version"] == 5
    assert recorded["weights"] == fingerprint(default)
    assert dict(run_of(world.out).facts())["Weights"].startswith(f"{name}. Trained on")
    assert describe_weights(default).to_dict()["version"] == 5
    assert rows_of(default)["weights"] == "default weights version 5"


def test_the_default_weights_of_before_have_none(world: World, narrow_default, caplog) -> None:
    caplog.set_level(NOTICE)
    settings = NetworkSettings(None, "cpu", engine="torch")
    predict_scans(world.data, world.out, settings=settings)
    assert "default weights (random) on cpu by torch in float32" in caplog.messages
    recorded = json.loads((world.out / "predict.json").read_text())["settings"]
    assert "weights_version" not in recorded
    assert "version" not in describe_weights(narrow_default).to_dict()
    assert "weights" not in rows_of(narrow_default)


def test_files_made_of_them_have_none(world: World, default: Path, tmp_path: Path) -> None:
    settings = NetworkSettings(default, "cpu", engine="torch")
    tune_temperature(world.data, tmp_path / "tuned.safetensors", settings=settings)
    assert read_card(tmp_path / "tuned.safetensors").version is None
    assert import_weights(default, tmp_path / "again.safetensors").version is None
