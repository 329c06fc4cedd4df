# SPDX-License-Identifier: MIT
"""Possible values of the fields of a record that users write, and their description in errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class FieldRule:
    """Possible values of a field."""

    allows: Callable[[Any], bool]  # Returns whether a value is possible
    expected: str  # Description of the possible values
