# SPDX-License-Identifier: MIT
"""Values of `--set`: changes of a recipe as texts."""

from collections.abc import Iterable

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.plain_data import refuse_unknown
from salsanext_cli.training.recipe import KINDS, Recipe, refuse_removed_keys

OPTION = "--set"


def read_overrides(texts: Iterable[str]) -> dict[str, object]:
    """Return the changes for `Recipe.with_changes` from texts ``key=value``; the last one wins."""
    changes: dict[str, object] = {}
    for text in texts:
        key, equals, value = map(str.strip, text.partition("="))
        if not (key and equals and value):
            raise UsageError(f"{OPTION} {text}", "not key=value", "key=value, such as batch=4")
        refuse_removed_keys([key], f"{OPTION} {text}")
        refuse_unknown({key: value}, Recipe, f"{OPTION} {text}")
        kind = type(getattr(Recipe(), key))
        if kind is str:
            # A word may be quoted as in TOML.
            value = value.strip("\"'")
        try:
            changes[key] = kind(value)
        except ValueError as error:
            raise UsageError(f"{OPTION} {key}", f"is {value!r}", KINDS[kind]) from error
    return changes
