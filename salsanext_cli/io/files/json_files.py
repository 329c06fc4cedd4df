# SPDX-License-Identifier: MIT
"""JSON files of records: frozen dataclasses as JSON objects, read back with their types."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from salsanext_cli.core.errors import OutputError, SalsanextError, error_text
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.reading import present, reading

Json = dict[str, Any]
"""JSON object, as `json.loads` returns it."""
Kind = TypeVar("Kind")
MALFORMED = (TypeError, LookupError, ValueError, AttributeError, RecursionError, SalsanextError)
"""Errors of `decoded` for data of another type."""


def plain(value: Any) -> Any:
    """Return plain data for JSON: records as objects, arrays and tuples as lists, NaN as None."""
    if hasattr(value, "to_dict"):
        value = value.to_dict()
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    match value:
        case float():
            return None if math.isnan(value) else value
        case Mapping():
            return {key: plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
        case set() | frozenset():
            return sorted(value)
        case np.ndarray():
            return plain(value.tolist())
        case Path():
            return str(value)
    return value


def as_json(value: Any) -> Any:
    """Return `plain` data as read from a file: with strings for keys and for infinity."""
    return json.loads(json.dumps(plain(value)), parse_constant=str)


def decoded(kind: Any, value: Any) -> Any:
    """Return plain data as a type, such as a record; raise one of `MALFORMED` for other data."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        if value is None and NoneType in inner:
            return None
        return decoded(next(member for member in inner if member is not NoneType), value)
    if hasattr(kind, "from_dict"):
        return kind.from_dict(value)
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, dict):
        types = _types(kind)
        return kind(**{name: decoded(types[name], value[name]) for name in types if name in value})
    if origin is tuple and inner[1:] != (...,):
        return tuple(decoded(*pair) for pair in zip(inner, value, strict=True))
    if origin in (list, tuple) and isinstance(value, list):
        return origin(decoded(inner[0], item) for item in value)
    if origin in (dict, Mapping) and isinstance(value, dict):
        return {key: decoded(inner[1], item) for key, item in value.items()}
    if kind is float and (type(value) is int or value == "Infinity"):
        return float(value)
    if kind not in (Any, object) and type(value) is not kind:
        raise TypeError(f"{value!r} is not a {getattr(kind, '__name__', kind)}")
    return value


@cache
def _types(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


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
