# SPDX-License-Identifier: MIT
"""Recipe of a training: typed settings with defaults that work, read from small TOML files."""

import json
import math
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any, Self

from salsanext_cli.errors import UsageError, shortened
from salsanext_cli.files.yaml_toml import read_toml, refuse_unknown

CHOICES = {
    "optimiser": ("sgd", "adamw"),
    "schedule": ("decay", "one-cycle"),
    "precision": ("auto", "float32", "bfloat16", "float16"),
    "sensors": ("given", "fitted"),
    "initial": ("random", "default"),
}
"""Words that the keys of type str may have."""
MAX_INTEGER = 2**53
"""Bound of whole numbers in place of others: floats are no longer exact beyond."""

READERS: dict[type, tuple[Callable[[str], Any], str]] = {
    int: (int, "a whole number"),
    float: (float, "a number"),
    str: (lambda text: text.strip("\"'"), "a word"),
}
"""Reader of the text of each type of key, and its name; quotes are taken for those of TOML."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Everything that decides what a training ends with; the defaults are the paper's.

    `docs/train.md` says what each key means.
    """

    architecture: str = "salsanext"
    initial: str = "random"
    precision: str = "float32"
    epochs: int = 150
    batch: int = 24
    accumulate: int = 1
    samples_per_epoch: int = 0
    crop_width: int = 0
    crop_on_class: float = 0.0
    whole_epochs: int = 0
    optimiser: str = "sgd"
    learning_rate: float = 0.01
    schedule: str = "decay"
    decay: float = 0.99
    warm_up: float = 1.0
    momentum: float = 0.9
    weight_decay: float = 1e-4
    clip_gradient: float = 0.0
    average: float = 0.0
    dropout: float = 0.2
    class_weight: float = 0.5
    lovasz: float = 1.0
    label_smoothing: float = 0.0
    rotate: float = 0.5
    shift: float = 0.5
    flip: float = 0.5
    drop: float = 0.5
    mix: float = 0.0
    paste: float = 0.0
    sensors: str = "given"
    also: float = 0.5
    streets: int = 0
    intensity: float = 0.0
    no_intensity: float = 0.0
    mount: float = 0.0
    view: float = 0.0
    fewer_beams: float = 0.0
    jitter: float = 0.0
    holes: float = 0.0
    validate_every: int = 1
    validation_scans: int = 0
    folds: int = 0
    seed: int = 1

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            kind = type(field.default)
            if kind is float and type(value) is int and abs(value) < MAX_INTEGER:
                value = float(value)
                object.__setattr__(self, field.name, value)
            if type(value) is not kind:
                found = shortened(value)
                raise UsageError(f"recipe key {field.name}", found, f"a {kind.__name__}")
            if kind is float:
                self._require(field.name, math.isfinite(getattr(self, field.name)), "finite")
        for key in ("epochs", "batch", "accumulate", "validate_every"):
            self._require(key, getattr(self, key) >= 1, "at least 1")
        of_scans = ("samples_per_epoch", "crop_width", "whole_epochs", "validation_scans")
        for key in (*of_scans, "streets", "seed"):
            self._require(key, getattr(self, key) >= 0, "at least 0")
        for key in ("weight_decay", "clip_gradient", "class_weight", "lovasz", "warm_up"):
            self._require(key, getattr(self, key) >= 0, "at least 0")
        changes = ("rotate", "shift", "flip", "drop", "mix", "paste")
        of_sensors = ("intensity", "no_intensity", "mount", "view", "fewer_beams")
        for key in (*changes, *of_sensors, "jitter", "holes", "also", "crop_on_class"):
            self._require(key, 0 <= getattr(self, key) <= 1, "between 0 and 1")
        for key in ("average", "dropout", "momentum", "label_smoothing"):
            self._require(key, 0 <= getattr(self, key) < 1, "from 0 to below 1")
        for key in ("learning_rate", "decay"):
            self._require(key, getattr(self, key) > 0, "above 0")
        self._require("seed", self.seed < 2**63, "below 2⁶³")
        self._require("folds", self.folds == 0 or self.folds >= 2, "0, or at least 2")
        steady = self.folds == 0 or self.schedule == "decay"
        self._require("schedule", steady, "decay with folds, which choose the number of epochs")
        for key, names in CHOICES.items():
            self._require(key, getattr(self, key) in names, f"one of {', '.join(names)}")

    def _require(self, key: str, holds: bool, expected: str) -> None:
        if not holds:
            raise UsageError(f"recipe key {key}", shortened(getattr(self, key)), expected)

    def with_changes(self, **changes: Any) -> Self:
        """Return the recipe with some keys changed; an unknown key raises `UsageError`."""
        return self.from_dict({**asdict(self), **changes})

    def to_dict(self) -> dict[str, Any]:
        """Return plain data that `from_dict` accepts."""
        return asdict(self)

    def to_toml(self) -> str:
        """Return the text of a TOML file that `recipe` reads."""
        return "".join(f"{key} = {json.dumps(value)}\n" for key, value in asdict(self).items())

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: object = "recipe") -> Self:
        """Build a recipe from plain data; keys that are left out keep the paper's value."""
        refuse_unknown(data, cls, source)
        return cls(**data)


def presets() -> tuple[str, ...]:
    """Return the names of the built-in recipes."""
    folder = resources.files("salsanext_cli").joinpath("presets/recipes")
    return tuple(sorted(Path(file.name).stem for file in folder.iterdir()))


def recipe(name_or_file: str | Path) -> Recipe:
    """Return a built-in recipe by name, or read one from a TOML file."""
    name = str(name_or_file)
    if name in presets():
        built_in = resources.files("salsanext_cli").joinpath(f"presets/recipes/{name}.toml")
        return Recipe.from_dict(tomllib.loads(built_in.read_text("utf-8")), name)
    path = Path(name_or_file)
    return Recipe.from_dict(read_toml(path, "recipe", presets()), path)


def read_overrides(texts: Iterable[str]) -> dict[str, Any]:
    """Return what `Recipe.with_changes` takes, of texts ``key=value``; the last of a key holds."""
    changes: dict[str, Any] = {}
    for text in texts:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not (key and equals and value):
            raise UsageError(f"--set {text}", "no key and value", "key=value, such as batch=4")
        refuse_unknown({key: value}, Recipe, f"--set {text}")
        read, expected = READERS[type(getattr(Recipe(), key))]
        try:
            changes[key] = read(value)
        except ValueError as error:
            raise UsageError(f"--set {key}={value}", f"{value!r}", expected) from error
    return changes
