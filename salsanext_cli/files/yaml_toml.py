# SPDX-License-Identifier: MIT
"""Readers of YAML and TOML files in bounded time and memory."""

import tomllib
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from salsanext_cli.errors import FormatError, UsageError, error_text, shortened
from salsanext_cli.files.reading import reading

MAX_YAML_BYTES, MAX_TOML_BYTES = 1 << 18, 1 << 14
"""Largest files; the time to read some texts grows with the square of their length."""
MAX_LINE_CHARACTERS = 1000  # A TOML key of thousands of parts takes hundreds of megabytes
MAX_NESTED_BRACKETS = 20  # Each YAML bracket makes later characters slower to read
YAML_ERRORS = (
    *(yaml.YAMLError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError),
    RecursionError,
)
"""Errors of PyYAML, its own and those of invalid dates and numbers."""


class _PlainLoader(yaml.SafeLoader):
    """Loader of plain values; a few lines of references to references would stand for billions."""

    def fetch_flow_collection_start(self, kind: Any) -> None:
        """Refuse brackets in too many brackets."""
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
        return yaml.load(text, _PlainLoader)
    except YAML_ERRORS as error:
        raise UsageError(path, error_text(error), expected) from error


def read_toml(path: Path, kind: str, presets: Iterable[str]) -> dict[str, Any]:
    """Read the TOML file of a setting, a "sensor" say, that is no preset."""
    expected = f"a TOML file with a {kind}'s keys"
    try:
        text = _text(path, MAX_TOML_BYTES, expected)
    except FileNotFoundError as error:
        found, names = "no preset and no file of that name", f"one of {', '.join(presets)}"
        raise UsageError(f"{kind} {path}", found, f"{names}, or a .toml file") from error
    if any(len(line) > MAX_LINE_CHARACTERS for line in text.splitlines()):
        raise UsageError(path, f"a line of more than {MAX_LINE_CHARACTERS} characters", expected)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(path, error_text(error), expected) from error


def _text(path: Path, largest: int, expected: str) -> str:
    try:
        with reading(path) as file:
            content = file.read(largest + 1)
    except ValueError as error:  # a path with a NUL
        raise UsageError(path, error_text(error), expected) from error
    except FormatError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            raise error.__cause__ from None
        raise UsageError(path, error.problem, expected) from error
    if len(content) > largest:
        raise UsageError(path, f"more than {largest} bytes", expected)
    try:
        return content.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise UsageError(path, error_text(error), expected) from error


def refuse_unknown(data: Iterable[str], kind: type, source: object) -> None:
    """Raise `UsageError` naming the fields of a dataclass if `data` has a key that is none."""
    known = sorted(field.name for field in fields(kind))
    if unknown := sorted(set(data) - set(known)):
        found = f"unknown key {shortened(', '.join(unknown))}"
        raise UsageError(source, found, f"keys {', '.join(known)}")


def are_numbers(values: object) -> bool:
    """Say whether a value is a list of numbers."""
    if not isinstance(values, list | tuple):
        return False
    return all(isinstance(value, int | float) for value in values)
