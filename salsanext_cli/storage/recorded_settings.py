# SPDX-License-Identifier: MIT
"""The settings that a stage recorded, as later stages read them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from salsanext_cli.errors import OutputError

Kind = TypeVar("Kind")


class RecordedSettings(dict[str, Any]):
    """Settings read back from `OUT/<stage>.json`; what was cut out of the file is named.

    Parameters
    ----------
    values : mapping
        The settings.
    path : Path
        The file that they were read from.
    """

    def __init__(self, values: Mapping[str, Any], path: Path) -> None:
        super().__init__(values)
        self.path = path

    def __missing__(self, key: str) -> Any:
        raise self._wrong(f"settings lack {key}", "what the stage wrote")

    def table(self, key: str) -> RecordedSettings:
        """Return a setting that is itself a mapping."""
        return RecordedSettings(self._as(dict, key, "a JSON object"), self.path)

    def flag(self, key: str) -> bool:
        """Return a setting that is true or false."""
        return self._as(bool, key, "true or false")

    def integer(self, key: str) -> int:
        """Return a setting that is a whole number."""
        return self._as(int, key, "a whole number")

    def number(self, key: str) -> float:
        """Return a setting that is a number; an infinite one is text in JSON."""
        value = self[key]
        if type(value) not in (int, float) and value != "Infinity":
            raise self._wrong(f"settings have {key} {value!r}", "a number")
        return float(value)

    def pair(self, key: str) -> tuple[float, float]:
        """Return a setting that is two numbers."""
        value = self._as(list, key, "two numbers")
        if [type(v) in (int, float) for v in value] != [True, True]:
            raise self._wrong(f"settings have {key} {value!r}", "two numbers")
        return float(value[0]), float(value[1])

    def _as(self, kind: type[Kind], key: str, expected: str) -> Kind:
        value = self[key]
        if type(value) is not kind:
            raise self._wrong(f"settings have {key} {value!r}", expected)
        return value

    def _wrong(self, found: str, expected: str) -> OutputError:
        return OutputError(self.path, found, expected, "delete it or use another folder")
