# SPDX-License-Identifier: MIT
from dataclasses import fields

import pytest

from salsanext_cli.errors import UsageError
from salsanext_cli.training.overrides import read_overrides
from salsanext_cli.training.recipe import Recipe, presets, recipe


def test_values_have_the_type_of_their_key_and_the_last_of_several_holds() -> None:
    texts = ["epochs=3", "learning_rate=1", " decay = 9.5e-1 ", "optimiser=adamw", "batch=08"]
    found = read_overrides(["batch=7", *texts])
    wanted = {"batch": 8, "epochs": 3, "learning_rate": 1.0, "decay": 0.95, "optimiser": "adamw"}
    assert found == wanted
    assert [type(value) for value in found.values()] == [int, int, float, float, str]


@pytest.mark.parametrize("name", presets())
def test_every_key_can_be_set_to_what_a_recipe_says(name: str) -> None:
    """The lines of a recipe file are overrides."""
    wanted = recipe(name)
    assert Recipe(seed=9).with_changes(**read_overrides(wanted.to_toml().splitlines())) == wanted
    assert len(wanted.to_toml().splitlines()) == len(fields(Recipe))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("epochs", r"--set epochs · no key and value · expected key=value"),
        ("=3", "no key and value"),
        ("epochs=", "no key and value"),
        ("", "no key and value"),
        ("epoch=3", r"--set epoch=3 · unknown key epoch · expected keys .*epochs"),
        ("epochs=3.5", r"--set epochs=3\.5 · '3\.5' · expected a whole number"),
        ("epochs=many", "expected a whole number"),
        ("flip=often", "'often' · expected a number"),
    ],
)
def test_what_cannot_be_read_is_named(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        read_overrides(["seed=3", text])
