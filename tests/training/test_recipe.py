# SPDX-License-Identifier: MIT
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from scans import refused

from salsanext_cli.commands.line.values.recipe_changes import read_overrides
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.optional_packages import extra_command
from salsanext_cli.training.recipe import Recipe, presets, recipe


def test_the_papers_recipe_is_the_papers() -> None:
    paper = recipe("paper")
    assert paper == Recipe()
    assert (paper.optimiser, paper.learning_rate, paper.momentum) == ("sgd", 0.01, 0.9)
    assert (paper.schedule, paper.decay, paper.warm_up) == ("decay", 0.99, 1.0)
    assert (paper.weight_decay, paper.batch, paper.epochs) == (1e-4, 24, 150)
    assert paper.precision == "float32"
    assert (paper.dropout, paper.crop_width, paper.lovasz) == (0.2, 0, 1.0)
    assert (paper.rotate, paper.shift, paper.flip, paper.drop) == (0.5, 0.5, 0.5, 0.5)


@pytest.mark.parametrize("name", presets())
def test_a_recipe_survives_its_toml_whose_lines_are_overrides(name: str, tmp_path: Path) -> None:
    path = tmp_path / "my recipe.toml"
    path.write_text(recipe(name).to_toml(), "utf-8")
    assert recipe(path) == recipe(name)
    assert tomllib.loads(recipe(name).to_toml()) == recipe(name).to_dict()
    lines = recipe(name).to_toml().splitlines()
    assert len(lines) == len(fields(Recipe))
    assert Recipe(seed=9).with_changes(**read_overrides(lines)) == recipe(name)


def test_an_unknown_key_or_recipe_and_an_impossible_value_are_refused(tmp_path):
    path = tmp_path / "typo.toml"
    path.write_text("epoch = 7\n", "utf-8")
    for subject, read in (
        (str(path), lambda: recipe(path)),
        ("recipe", lambda: Recipe().with_changes(learnig_rate=1.0)),
        ("recipe papr", lambda: recipe("papr")),
    ):
        refused(UsageError, subject, read)
    for key, value in (
        *(("epochs", 0), ("epochs", 1.5), ("decay", 10**400), ("precision", "float64")),
        *(("learning_rate", 0.0), ("learning_rate", "fast"), ("learning_rate", float("nan"))),
        *(("warm_up", float("inf")), ("flip", -0.1), ("jitter", 1.5)),
        *(("folds", 1), ("seed", 2**63)),
        *(("widths", "512,wide"), ("widths", "512,0"), ("widths", "1e3"), ("widths", ",")),
    ):
        with refused(UsageError, f"recipe key {key}"):
            Recipe().with_changes(**{key: value})


@pytest.mark.parametrize("name", ["paper-v1", "rangenet53"])
def test_removed_recipes_name_what_to_use_unless_a_file_has_the_name(name, tmp_path, monkeypatch):
    hint = refused(UsageError, f"recipe {name}", recipe, name).value.hint
    assert extra_command("paper") in hint
    network = "salsanext-v1" if name == "paper-v1" else name
    assert f'architecture="{network}"' in hint
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("epochs = 7", "utf-8")
    assert recipe(name).epochs == 7


@pytest.mark.parametrize("key", ["label_smoothing", "whole_epochs", "heteroscedastic"])
def test_removed_keys_are_answered_by_a_hint(key, tmp_path):
    path = tmp_path / "old.toml"
    path.write_text(f"epochs = 7\n{key} = 1\n", "utf-8")
    for subject, read in (
        (path, lambda: recipe(path)),
        (f"--set {key}=1", lambda: read_overrides([f"{key}=1"])),
    ):
        error = refused(UsageError, subject, read).value
        assert key in error.problem
        assert error.hint


def test_windows_fit_images_of_every_width() -> None:
    assert Recipe().image_widths == ()
    assert Recipe(widths="1024").image_widths == (1024,)
    windows = Recipe(widths="1024, 512,1024", crop_width=512)
    assert windows.image_widths == (1024, 512, 1024)
    for crop_width in (0, 513):
        with refused(UsageError, "recipe key crop_width"):
            windows.with_changes(crop_width=crop_width)


# Overrides


def test_values_have_the_type_of_their_key_and_the_last_of_several_holds() -> None:
    texts = ["epochs=3", "learning_rate=1", " decay = 9.5e-1 ", "optimiser=adamw", "batch=08"]
    changes = read_overrides(["batch=7", *texts])
    wanted = {"batch": 8, "epochs": 3, "learning_rate": 1.0, "decay": 0.95, "optimiser": "adamw"}
    assert changes == wanted
    assert [type(value) for value in changes.values()] == [int, int, float, float, str]


@pytest.mark.parametrize(
    ("text", "subject"),
    [
        ("epochs", "--set epochs"),
        ("=3", "--set =3"),
        ("epoch=3", "--set epoch=3"),
        ("epochs=3.5", "--set epochs"),
        ("flip=often", "--set flip"),
    ],
)
def test_an_unreadable_override_is_the_subject_of_the_error(text: str, subject: str) -> None:
    refused(UsageError, subject, read_overrides, ["seed=3", text])
