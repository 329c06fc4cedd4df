# SPDX-License-Identifier: MIT
"""Tables of label spaces in plain data: their types, and whether they agree with each other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import Any

from salsanext_cli.core.texts import first_few, shortened

ALTERNATIVES = "learning_alternatives"
RAW_ID_COUNT = 1 << 16
UNKNOWN = 255  # Train id of unknown raw ids
UNASSIGNED_CODE = 1  # Code of the ASPRS of points without a class
FIRST_USER_CODE = 64  # The ASPRS leaves codes from here on to users
LAST_CODE = 255
SHOWN_DIGITS = 20  # Longest text of an id in an error


def contradiction(
    labels: dict[int, str],
    learning_map: dict[int, int],
    inverse: dict[int, int],
    alternatives: dict[int, tuple[int, ...]],
    movable: tuple[int, ...],
) -> str:
    """Return a description of an inconsistency, empty without one."""
    train_ids = set(inverse)
    if not inverse or sorted(inverse) != list(range(len(inverse))) or len(inverse) > UNKNOWN:
        return f"has train ids {_listed(inverse)}, not 0…C-1 with C ≤ {UNKNOWN}"
    wide = [i for i in [*learning_map, *labels] if not 0 <= i < RAW_ID_COUNT]
    if wide:
        return f"has raw ids {_listed(wide)} beyond 16 bits"
    targets = set(learning_map.values()) - train_ids
    if targets:
        return f"has train ids {_listed(targets)} in learning_map but not in learning_map_inv"
    nameless = set(inverse.values()) - set(labels)
    if nameless:
        return f"lacks names of raw ids {_listed(nameless)} in labels"
    possible = {train_id for members in alternatives.values() for train_id in members}
    if possible - train_ids:
        ids = _listed(possible - train_ids)
        return f"has train ids {ids} in {ALTERNATIVES} but not in learning_map_inv"
    immovable = set(movable) - (train_ids - {0})
    if immovable:
        return f"has train ids {_listed(immovable)} in movable, not 1…C-1"
    lacking = [i for i, members in alternatives.items() if learning_map.get(i) not in members]
    if lacking:
        return f"lacks the train ids of raw ids {_listed(lacking)} in their {ALTERNATIVES}"
    return ""


def _listed(ids: Iterable[int]) -> str:
    """Return a short text of ids of any number and size."""
    return first_few([shortened(i, SHOWN_DIGITS) for i in sorted(ids)])


def integers(table: Mapping[Any, Any]) -> dict[int, int]:
    """Return a table of integers, which YAML may have as texts."""
    return {int(key): int(value) for key, value in table.items()}


def as_codes(table: Mapping[Any, Any]) -> dict[int, int]:
    """Return a table of integers from 0 to 255; others raise `ValueError`."""
    code_of = integers(table)
    wide = [code for code in code_of.values() if not 0 <= code <= LAST_CODE]
    if wide:
        raise ValueError(f"{_listed(wide)} is not a code from 0 to {LAST_CODE}")
    return code_of


def codes_of_train_ids(learning_map: Mapping[int, int]) -> dict[int, int]:
    """Return codes of the ASPRS for users by raw id: 64 + train id, and 1 of train id 0.

    Train ids above 191 have none.
    """
    codes = {raw: FIRST_USER_CODE + train_id for raw, train_id in learning_map.items()}
    unlabelled = {raw: UNASSIGNED_CODE for raw, train_id in learning_map.items() if not train_id}
    return {raw: code for raw, code in (codes | unlabelled).items() if code <= LAST_CODE}


def sequence_name(member: object) -> str:
    """Return the name of a sequence, which YAML may have as a number."""
    return f"{member:02d}" if isinstance(member, int) else str(member)


def entries(members: object) -> list[Any]:
    """Return the members of a list; anything else raises `TypeError`."""
    if not isinstance(members, list | tuple):
        raise TypeError(f"{shortened(members)} is not a list")
    return list(members)


def as_colour(channels: Any) -> list[int]:
    """Return the three bytes of a colour; anything else raises `ValueError`."""
    colour = [int(channel) for channel in islice(channels, 4)]
    if len(colour) != 3 or not all(0 <= channel <= 255 for channel in colour):
        raise ValueError(f"{shortened(channels)} is not a colour of 3 bytes")
    return colour


def spare_colour(train_id: int) -> list[int]:
    """Return a fixed blue, green, red for a class without a colour; unlabelled is black."""
    return [0, 0, 0] if train_id == 0 else [(train_id * step) % 206 + 50 for step in (67, 109, 151)]
