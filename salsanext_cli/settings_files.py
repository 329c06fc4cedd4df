# SPDX-License-Identifier: MIT
"""Settings that people write, as YAML and TOML: read in bounded time and memory."""

from __future__ import annotations

import stat
import tomllib
from pathlib import Path
from typing import Any

import yaml

from salsanext_cli.errors import UsageError

LARGEST_YAML, LARGEST_TOML = 1 << 18, 1 << 14
"""Bytes of such a file, many times what any has that a person wrote; reading some texts takes
time by the square of their length.
"""
LONGEST_LINE = 1000
"""Characters; a key of thousands of parts on a line of TOML takes hundreds of megabytes."""
DEEPEST = 20
"""Brackets within brackets; each more makes every character after it slower to read."""
SHOWN = 100
"""Characters of a wrong value that an error shows."""
WRONG_YAML = (
    *(yaml.YAMLError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError),
    RecursionError,
)
"""What PyYAML raises over text; beside its own errors, those of dates and numbers that are none."""


class _PlainLoader(yaml.SafeLoader):
    """Builds plain values only, without references.

    A few lines of references to references would stand for billions of values.
    """

    def fetch_flow_collection_start(self, kind: Any) -> None:
        """Refuse brackets in too many brackets."""
        if self.flow_level >= DEEPEST:
            raise RecursionError
        super().fetch_flow_collection_start(kind)

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse a reference."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.MarkedYAMLError(None, None, f"a reference *{event.anchor}", event.start_mark)
        return super().compose_node(parent, index)


def read_yaml(path: Path, expected: str) -> Any:
    """Read plain values from a YAML file; references (``*name``) are refused.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    UsageError
        If it cannot be read; what was `expected` is said.
    """
    text = _text(path, LARGEST_YAML, expected)
    try:
        return yaml.load(text, _PlainLoader)
    except WRONG_YAML as error:
        raise UsageError(path, words_of(error), expected) from error


def read_toml(path: Path, expected: str) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    UsageError
        If it cannot be read; what was `expected` is said.
    """
    text = _text(path, LARGEST_TOML, expected)
    if any(len(line) > LONGEST_LINE for line in text.splitlines()):
        raise UsageError(path, f"a line of more than {LONGEST_LINE} characters", expected)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(path, words_of(error), expected) from error


def _text(path: Path, largest: int, expected: str) -> str:
    try:
        # A pipe would block, and a device may never end.
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise UsageError(path, "not a file", expected)
        with path.open("rb") as file:
            content = file.read(largest + 1)
        if len(content) > largest:
            raise UsageError(path, f"more than {largest} bytes", expected)
        return content.decode("utf-8").replace("\r\n", "\n")
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        raise UsageError(path, words_of(error), expected) from error


def words_of(error: BaseException) -> str:
    """Return what an error says on one line of bearable length."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    return shortened(" ".join(str(error).split()) or type(error).__name__, 3 * SHOWN)


def shortened(value: object, length: int = SHOWN) -> str:
    """Show a value, however large it is."""
    if isinstance(value, int) and value.bit_length() > 4 * length:
        # Python refuses to write out numbers of thousands of digits.
        return f"a number of {value.bit_length()} bits"
    try:
        text = value if isinstance(value, str) else repr(value)
    except (ValueError, RecursionError):
        return f"a {type(value).__name__}"
    return text if len(text) <= length else text[: length - 1] + "…"
