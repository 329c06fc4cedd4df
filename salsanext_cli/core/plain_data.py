# SPDX-License-Identifier: MIT
"""Records as plain data for JSON, and plain data as records of their types."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.texts import did_you_mean, shortened

Json = dict[str, Any]
"""JSON object, as `json.loads` returns it."""
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
    origin = get_origin(kind)
    inner = get_args(kind)
    if origin in (Union, UnionType):
        return _decoded_member(inner, value)
    if hasattr(kind, "from_dict"):
        return kind.from_dict(value)
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, dict):
        types = _types(kind)
        return kind(**{name: decoded(types[name], value[name]) for name in types if name in value})
    if origin is tuple and inner[1:] != (...,):
        pairs = zip(inner, value, strict=True)
        return tuple(decoded(member, item) for member, item in pairs)
    if origin in (list, tuple) and isinstance(value, list):
        return origin(decoded(inner[0], item) for item in value)
    if origin in (dict, Mapping) and isinstance(value, dict):
        return {key: decoded(inner[1], item) for key, item in value.items()}
    if kind is float and (type(value) is int or value == "Infinity"):
        return float(value)
    if kind not in (Any, object) and type(value) is not kind:
        raise TypeError(f"{value!r} is not a {getattr(kind, '__name__', kind)}")
    return value


def _decoded_member(kinds: Sequence[Any], value: Any) -> Any:
    """Return plain data as the first type of a union that takes it, an equal type before others."""
    if type(value) in kinds:
        return value
    members = [kind for kind in kinds if kind is not NoneType]
    for kind in members[:-1]:
        with suppress(*MALFORMED):
            return decoded(kind, value)
    return decoded(members[-1], value)


@cache
def _types(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def refuse_unknown(data: Iterable[str], kind: type, source: object) -> None:
    """Raise `UsageError` if `data` has a key that is not a field of a dataclass."""
    keys = sorted(field.name for field in fields(kind))
    unknown = sorted(set(data) - set(keys))
    if unknown:
        problem = f"has unknown keys {shortened(', '.join(unknown))}"
        hint = did_you_mean(unknown[0], keys)
        if hint:
            raise UsageError(source, problem, hint=hint)
        raise UsageError(source, problem, f"keys {', '.join(keys)}")


def are_numbers(values: object) -> bool:
    """Return whether a value is a list of numbers."""
    return isinstance(values, list | tuple) and all(isinstance(v, int | float) for v in values)
