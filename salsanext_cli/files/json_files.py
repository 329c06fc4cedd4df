# SPDX-License-Identifier: MIT
"""Small records as JSON files, and the settings of a stage read back from one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import write_bytes
from salsanext_cli.files.reading import present, reading


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write plain data as JSON, durably; names of files may be no text, so only ASCII."""
    write_bytes(path, encode_json(data), durable=True)


def encode_json(data: Mapping[str, Any]) -> bytes:
    """Return the content of a JSON file of plain data."""
    return (json.dumps(data, indent=2, allow_nan=False) + "\n").encode("ascii")


def read_json(path: Path) -> dict[str, Any] | None:
    """Read what `write_json` wrote; None if there is no such file."""
    if not present(path):
        return None
    with reading(path) as file:
        text = file.read()
    try:
        return dict[str, Any](json.loads(text).items())
    except (ValueError, RecursionError, AttributeError) as error:
        found, remedy = "damaged", "delete it or use another folder"
        raise OutputError(path, found, "a JSON object", remedy) from error


class RecordedSettings(dict[str, Any]):
    """Settings read back from a file `OUT/<stage>.json`; what was cut out of it is named."""

    def __init__(self, values: Mapping[str, Any], path: Path) -> None:
        super().__init__(values)
        self.path = path

    def __missing__(self, key: str) -> Any:
        raise self._wrong(f"settings lack {key}", "what the stage wrote")

    def table(self, key: str) -> RecordedSettings:
        """Return a setting that is itself a mapping."""
        return RecordedSettings(self._of_type(key, "a JSON object", dict), self.path)

    def number(self, key: str) -> float:
        """Return a setting that is a number."""
        return float(self._of_type(key, "a number", int, float))

    def numbers(self, key: str) -> tuple[float, ...]:
        """Return a setting that is two numbers or more."""
        value = self._of_type(key, "two numbers or more", list)
        if len(value) < 2 or any(type(v) not in (int, float) for v in value):
            raise self._wrong(f"settings have {key} {value!r}", "two numbers or more")
        return tuple(map(float, value))

    def _of_type(self, key: str, expected: str, *types: type) -> Any:
        value = self[key]
        if type(value) not in types:
            raise self._wrong(f"settings have {key} {value!r}", expected)
        return value

    def _wrong(self, found: str, expected: str) -> OutputError:
        return OutputError(self.path, found, expected, "delete it or use another folder")
