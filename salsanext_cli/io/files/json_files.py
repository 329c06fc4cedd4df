# SPDX-License-Identifier: MIT
"""JSON files of records: frozen dataclasses as JSON objects, read back with their types."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.plain_data import MALFORMED, Json, decoded, plain
from salsanext_cli.core.texts import error_text
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.reading import present, reading

Kind = TypeVar("Kind")


def write_json(path: Path, data: object) -> None:
    """Write a record, or plain data, as JSON, durably."""
    write_bytes(path, encode_json(data), durable=True)


def encode_json(data: object) -> bytes:
    """Return the content of a JSON file, in ASCII, since file names may not be text."""
    return (json.dumps(plain(data), indent=2, allow_nan=False) + "\n").encode("ascii")


def read_json(path: Path) -> Json | None:
    """Read a JSON object; None if there is no such file."""
    if not present(path):
        return None
    with reading(path) as file:
        text = file.read()
    try:
        return Json(json.loads(text).items())
    except (ValueError, RecursionError, AttributeError) as error:
        hint = "delete it or use another folder"
        raise OutputError(path, "is damaged", "a JSON object", hint) from error


def read_record(kind: type[Kind], path: Path) -> Kind | None:
    """Read a record; None if there is no such file."""
    data = read_json(path)
    return None if data is None else record_of(kind, data, path)


def record_of(kind: type[Kind], data: Mapping[str, object], path: Path) -> Kind:
    """Return the record in the content of a file, or raise `OutputError`."""
    try:
        record: Kind = decoded(kind, data)
    except MALFORMED as error:
        problem = f"is not a record of salsanext: {error_text(error)}"
        raise OutputError(path, problem, hint="delete it or use another folder") from error
    return record
