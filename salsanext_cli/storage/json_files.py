# SPDX-License-Identifier: MIT
"""Small records as JSON files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.reading import present, reading
from salsanext_cli.storage.atomic import write_bytes

MAX_NESTING = 20


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write plain data as JSON, durably; names of files may be no text, so only ASCII."""
    write_bytes(path, encode_json(data), durable=True)


def encode_json(data: Mapping[str, Any]) -> bytes:
    """Return the content of a JSON file of plain data."""
    return (json.dumps(data, indent=2, allow_nan=False) + "\n").encode("ascii")


def read_json(path: Path) -> dict[str, Any] | None:
    """Read what `write_json` wrote; None if there is no such file.

    Raises
    ------
    OutputError
        If the file is damaged.
    """
    if not present(path):
        return None
    with reading(path) as file:
        text = file.read()
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise OutputError(path, "damaged", "JSON", "delete it or use another folder") from error
    if not isinstance(data, dict) or not _is_shallow(data):
        raise OutputError(path, "damaged", "a JSON object", "delete it or use another folder")
    return data


def _is_shallow(data: dict[str, Any]) -> bool:
    """Say whether data is nested no deeper than records are."""
    level: list[Any] = [data]
    for _ in range(MAX_NESTING):
        members = (each.values() if isinstance(each, dict) else each for each in level)
        level = [m for each in members for m in each if isinstance(m, dict | list)]
    return not level


def _refuse_constant(name: str) -> None:
    """Refuse NaN and infinities, which `write_json` never writes."""
    raise ValueError(f"{name} is no JSON")
