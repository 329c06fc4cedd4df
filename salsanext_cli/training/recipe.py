# SPDX-License-Identifier: MIT
"""Recipe of a training: typed settings with defaults that work, read from small TOML files."""

import json
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Self

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.field_rules import FieldRule
from salsanext_cli.core.optional_packages import extra_command
from salsanext_cli.core.plain_data import refuse_unknown
from salsanext_cli.core.texts import shortened
from salsanext_cli.core.wording import command, setting
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.files.yaml_toml import read_toml

BUILT_IN = resources.files("salsanext_cli").joinpath("presets/recipes")
MAX_INTEGER = 2**53  # Beyond it, floats are not exact
KINDS = {int: "a whole number", float: "a number", str: "a word"}  # Names of the types of keys

OMIT = "omit it"
REMOVED_KEYS = {
    "disagreement": OMIT,
    "heteroscedastic": "omit it, and use `uncertainty` on the trained weights",
    "label_smoothing": OMIT,
    "whole_epochs": "omit it, or set crop_width = 0 for whole images in all epochs",
}
"""Hint by key of recipes of earlier versions."""
REMOVED_RECIPES = ("paper-v1", "rangenet53")
"""Recipes of earlier versions, whose networks the extra `paper` has."""

Positive = Annotated[int, FieldRule(lambda value: value >= 1, "at least 1")]
Count = Annotated[int, FieldRule(lambda value: value >= 0, "at least 0")]
Folds = Annotated[int, FieldRule(lambda value: value == 0 or value >= 2, "0, or at least 2")]
Seed = Annotated[int, FieldRule(lambda value: 0 <= value < 2**63, "from 0 to below 2⁶³")]
Amount = Annotated[float, FieldRule(lambda value: value >= 0, "at least 0")]
Rate = Annotated[float, FieldRule(lambda value: value > 0, "above 0")]
Share = Annotated[float, FieldRule(lambda value: 0 <= value <= 1, "between 0 and 1")]
ShareBelow1 = Annotated[float, FieldRule(lambda value: 0 <= value < 1, "from 0 to below 1")]
"""Types of keys with the rule for their values."""


def are_widths(text: str) -> bool:
    """Return whether a text lists widths of images, or is empty."""
    numbers = text.split(",") if text else []
    return all(number.strip().isdecimal() and int(number) > 0 for number in numbers)


Widths = Annotated[str, FieldRule(are_widths, "numbers of columns, such as 512,1024,2048")]


def one_of(*words: str) -> FieldRule:
    """Return the rule for a key that accepts some words."""
    return FieldRule(words.__contains__, f"one of {', '.join(words)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Everything that determines the result of a training; the defaults are the paper's."""

    architecture: str = "salsanext"
    initial: Annotated[str, one_of("random", "default")] = "random"
    precision: Annotated[str, one_of("auto", "float32", "bfloat16", "float16")] = "float32"
    epochs: Positive = 150
    batch: Positive = 24
    accumulate: Positive = 1
    samples_per_epoch: Count = 0
    widths: Widths = ""
    crop_width: Count = 0
    crop_on_class: Share = 0.0
    optimiser: Annotated[str, one_of("sgd", "adamw")] = "sgd"
    learning_rate: Rate = 0.01
    schedule: Annotated[str, one_of("decay", "one-cycle")] = "decay"
    decay: Rate = 0.99
    warm_up: Amount = 1.0
    momentum: ShareBelow1 = 0.9
    weight_decay: Amount = 1e-4
    clip_gradient: Amount = 0.0
    average: ShareBelow1 = 0.0
    dropout: ShareBelow1 = 0.2
    class_weight: Amount = 0.5
    lovasz: Amount = 1.0
    rotate: Share = 0.5
    shift: Share = 0.5
    flip: Share = 0.5
    drop: Share = 0.5
    mix: Share = 0.0
    paste: Share = 0.0
    sensors: Annotated[str, one_of("given", "fitted")] = "given"
    also: Share = 0.5
    streets: Count = 0
    intensity: Share = 0.0
    no_intensity: Share = 0.0
    mount: Share = 0.0
    view: Share = 0.0
    fewer_beams: Share = 0.0
    jitter: Share = 0.0
    holes: Share = 0.0
    validate_every: Positive = 1
    validation_scans: Count = 0
    folds: Folds = 0
    seed: Seed = 1

    def __post_init__(self) -> None:
        for key in fields(self):
            value = getattr(self, key.name)
            kind = type(key.default)
            if kind is float and type(value) is int and abs(value) < MAX_INTEGER:
                value = float(value)
                object.__setattr__(self, key.name, value)
            self._require(key.name, type(value) is kind, KINDS[kind])
            if kind is float:
                self._require(key.name, math.isfinite(value), "finite")
            for rule in getattr(key.type, "__metadata__", ()):
                self._require(key.name, rule.allows(value), rule.expected)
        narrowest = min(self.image_widths, default=0)
        fits = len({*self.image_widths}) < 2 or 1 <= self.crop_width <= narrowest
        self._require("crop_width", fits, f"from 1 to {narrowest}, which fits all widths")
        steady = self.folds == 0 or self.schedule == "decay"
        self._require("schedule", steady, "decay with folds, which choose the number of epochs")

    def _require(self, key: str, is_right: bool, expected: str) -> None:
        if not is_right:
            value = shortened(repr(getattr(self, key)))
            raise UsageError(f"recipe key {key}", f"is {value}", expected)

    @property
    def image_widths(self) -> tuple[int, ...]:
        """Widths of the images of samples in columns; none for that of the sensor."""
        return tuple(int(number) for number in self.widths.split(",")) if self.widths else ()

    def with_changes(self, **changes: Any) -> Self:
        """Return the recipe with some keys changed; an unknown key raises `UsageError`."""
        return self.from_dict({**asdict(self), **changes})

    def to_dict(self) -> dict[str, object]:
        """Return plain data that `from_dict` accepts."""
        return asdict(self)

    def to_toml(self) -> str:
        """Return the text of a TOML file that `recipe` reads."""
        return "".join(f"{key} = {json.dumps(value)}\n" for key, value in asdict(self).items())

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: object = "recipe") -> Self:
        """Build a recipe from plain data; absent keys have the paper's value."""
        refuse_removed_keys(data, source)
        refuse_unknown(data, cls, source)
        return cls(**data)


def refuse_removed_keys(keys: Iterable[str], source: object) -> None:
    """Refuse keys of earlier versions with what replaces the first of them."""
    if removed := sorted({*keys} & REMOVED_KEYS.keys()):
        key = removed[0]
        raise UsageError(source, f"the recipe key {key} was removed", hint=REMOVED_KEYS[key])


def presets() -> tuple[str, ...]:
    """Return the names of the built-in recipes."""
    return tuple(sorted(Path(file.name).stem for file in BUILT_IN.iterdir()))


def recipe(name_or_file: str | Path) -> Recipe:
    """Return a built-in recipe by name, or read one from a TOML file."""
    name = str(name_or_file)
    if name in presets():
        text = BUILT_IN.joinpath(f"{name}.toml").read_text("utf-8")
        return Recipe.from_dict(tomllib.loads(text), name)
    path = Path(name_or_file)
    if name in REMOVED_RECIPES and not present(path):
        raise UsageError(f"recipe {name}", "was removed", hint=_removed_recipe_hint(name))
    return Recipe.from_dict(read_toml(path, "recipe", presets()), path)


def _removed_recipe_hint(name: str) -> str:
    """Return what replaces a recipe of earlier versions."""
    network = "salsanext-v1" if name == "paper-v1" else name
    named = command(setting("recipe", "paper"), setting("recipe.architecture", network))
    return f"{extra_command('paper')}; then use {named}"
