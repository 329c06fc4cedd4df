# SPDX-License-Identifier: MIT
"""Changes of a recipe that are given as texts, as ``--set`` takes them."""

from collections.abc import Callable, Iterable
from typing import Any

from salsanext_cli.errors import UsageError
from salsanext_cli.files.yaml_toml import refuse_unknown
from salsanext_cli.training.recipe import Recipe

READERS: dict[type, tuple[Callable[[str], Any], str]] = {
    int: (int, "a whole number"),
    float: (float, "a number"),
    str: (lambda text: text.strip("\"'"), "a word"),
}
"""Reader of the text of each type of key, and its name; quotes are taken for those of TOML."""


def read_overrides(texts: Iterable[str]) -> dict[str, Any]:
    """Return what `Recipe.with_changes` takes; of a key given twice the last value holds.

    Raises
    ------
    UsageError
        If a text is no ``key=value``, the key is unknown or the value not of its type.
    """
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
