# SPDX-License-Identifier: MIT
from pathlib import Path

import pytest
from command_line import only_json, subject
from scans import SMALL, write_sequence

from salsanext_cli.core.engines.device import bfloat16_instructions
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.training.recipe import recipe

pytestmark = pytest.mark.usefixtures("tiny_training")


def test_the_run_folder_and_the_weights_record_the_changed_recipe(run, data, tmp_path):
    write_sequence(data / "sequences/00", ["0", "1"], count=300)
    changes = ("--set", "batch=1", "--set", "schedule=decay", "--set", "epochs=5", "--epochs", 1)
    folder = tmp_path / "run"
    small = tmp_path / "small.toml"
    small.write_text(SMALL.to_toml())
    given = ("train", data, folder, "--recipe", "quick", "--sensor", small, "--json")
    result = run(*given, *changes, status=0)
    precision = "bfloat16" if bfloat16_instructions() else "float32"
    wanted = recipe("quick").with_changes(precision=precision, batch=1, schedule="decay", epochs=1)
    assert recipe(folder / "recipe.toml") == wanted
    best = only_json(result)["best"]
    assert read_card(Path(best)).recipe == wanted.to_dict()
    assert f"next: salsanext predict SCANS OUT --weights {best}" in result.stderr
    again = run(*given, *changes)
    assert "complete after 1 of 1 epochs" in again.stderr
    assert "going on" not in again.stderr


def test_a_batch_too_small_for_the_workers(run, data, tmp_path, monkeypatch):
    """It is refused before the workers are connected."""
    write_sequence(data / "sequences/00", ["0", "1"], count=300)
    for name, value in {"RANK": "0", "WORLD_SIZE": "3", "TORCHELASTIC_RUN_ID": "x"}.items():
        monkeypatch.setenv(name, value)
    result = run("train", data, tmp_path / "run", "--recipe", "quick")
    assert (result.exit_code, subject(result)) == (2, "recipe key batch")
