# SPDX-License-Identifier: MIT
import tomllib
from pathlib import Path

import pytest

from salsanext_cli.errors import UsageError
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
    assert recipe("paper-v1") == Recipe(architecture="salsanext-v1")


def test_only_the_modern_recipe_mixes_scans() -> None:
    keys = ("mix", "paste", "label_smoothing", "whole_epochs")
    mixing = {name for name in presets() if any(getattr(recipe(name), key) for key in keys)}
    assert mixing == {"modern"}
    assert all(getattr(recipe("modern"), key) for key in keys)


@pytest.mark.parametrize("name", presets())
def test_a_recipe_survives_its_toml(name: str, tmp_path: Path) -> None:
    path = tmp_path / "my recipe.toml"
    path.write_text(recipe(name).to_toml(), "utf-8")
    assert recipe(path) == recipe(name)
    assert tomllib.loads(recipe(name).to_toml()) == recipe(name).to_dict()


def test_an_unknown_key_names_the_known_ones(tmp_path: Path) -> None:
    path = tmp_path / "typo.toml"
    path.write_text("epoch = 7\n", "utf-8")
    with pytest.raises(
        UsageError, match=r"typo\.toml · unknown key epoch · .*epochs.*weight_decay"
    ):
        recipe(path)
    with pytest.raises(UsageError, match="unknown key learnig_rate"):
        Recipe().with_changes(learnig_rate=1.0)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("epochs", 0),
        ("epochs", 1.5),
        ("decay", 10**400),
        ("accumulate", 0),
        ("precision", "float64"),
        ("learning_rate", 0.0),
        ("learning_rate", "fast"),
        ("learning_rate", float("nan")),
        ("warm_up", float("inf")),
        ("dropout", 1.5),
        ("flip", -0.1),
        ("paste", -0.5),
        ("label_smoothing", 1.0),
        ("whole_epochs", -1),
        ("average", 1.0),
    ],
)
def test_impossible_values_name_the_key(key: str, value: object) -> None:
    with pytest.raises(UsageError, match=f"recipe key {key}"):
        Recipe().with_changes(**{key: value})


def test_no_such_recipe_names_the_presets() -> None:
    with pytest.raises(UsageError, match=r"recipe papr .* one of modern, paper, .* street"):
        recipe("papr")


@pytest.mark.parametrize("content", [b"epochs = ", b"\xff\xfe", b"[epochs]\nx = 1\n"])
def test_not_a_recipe(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(UsageError):
        recipe(path)
