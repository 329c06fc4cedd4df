# SPDX-License-Identifier: MIT
"""Readers of YAML and TOML files in bounded time and memory."""

import tomllib
from collections.abc import Iterable
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from salsanext_cli.core.errors import FormatError, UsageError
from salsanext_cli.core.texts import did_you_mean, error_text
from salsanext_cli.io.files.reading import reading

MAX_YAML_BYTES = 1 << 18  # The time to read some texts is quadratic in their length.
MAX_TOML_BYTES = 1 << 14
MAX_LINE_CHARACTERS = 1000  # A TOML key of thousands of parts takes hundreds of megabytes
MAX_NESTED_BRACKETS = 20  # Each YAML bracket makes later characters slower to read
YAML_ERRORS = (
    yaml.YAMLError,
    ArithmeticError,
    AttributeError,
    LookupError,
    TypeError,
    ValueError,
    RecursionError,
)
"""Errors of PyYAML, including those of invalid dates and numbers."""


class _PlainLoader(yaml.SafeLoader):
    """Loader of plain values; nested references could expand a few lines to billions."""

    def fetch_flow_collection_start(self, kind: Any) -> None:
        """Refuse brackets that are nested too deeply."""
        if self.flow_level >= MAX_NESTED_BRACKETS:
            raise RecursionError
        super().fetch_flow_collection_start(kind)

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse a reference."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(None, None, f"a reference *{event.anchor}", event.start_mark)
        return super().compose_node(parent, index)


def read_yaml(path: Path, expected: str) -> Any:
    """Read plain values from a YAML file; references (``*name``) are refused."""
    text = _text(path, MAX_YAML_BYTES, expected)
    try:
        return deepcopy(_plain_values(text))
    except YAML_ERRORS as error:
        raise UsageError(path, error_text(error), expected) from error


@lru_cache(maxsize=4)
def _plain_values(text: str) -> Any:
    """Return the values of a text in YAML, which a command reads in several of its steps."""
    return yaml.load(text, _PlainLoader)


def read_toml(path: Path, kind: str, presets: Iterable[str]) -> dict[str, Any]:
    """Read the TOML file of a setting that is not a preset.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        Kind of the setting, such as "sensor", for errors.
    presets : iterable of str
        Names of the presets, for errors.

    Returns
    -------
    dict
        Content of the file.

    Raises
    ------
    UsageError
        If there is no such file, or it is no TOML.
    """
    expected = f"a TOML file with the keys of a {kind}"
    try:
        text = _text(path, MAX_TOML_BYTES, expected)
    except FileNotFoundError as error:
        expected = f"one of {', '.join(presets)}, or a .toml file"
        hint = did_you_mean(str(path), presets)
        raise UsageError(f"{kind} {path}", "no such preset or file", expected, hint) from error
    if any(len(line) > MAX_LINE_CHARACTERS for line in text.splitlines()):
        problem = f"has a line of more than {MAX_LINE_CHARACTERS} characters"
        raise UsageError(path, problem, expected)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(path, error_text(error), expected) from error


def _text(path: Path, largest: int, expected: str) -> str:
    try:
        with reading(path) as file:
            content = file.read(largest + 1)
        if len(content) <= largest:
            return content.decode("utf-8").replace("\r\n", "\n")
    except ValueError as error:  # a path with a NUL, or not UTF-8
        raise UsageError(path, error_text(error), expected) from error
    except FormatError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            raise error.__cause__ from None
        raise UsageError(path, error.problem, expected) from error
    raise UsageError(path, f"has more than {largest} bytes", expected)
