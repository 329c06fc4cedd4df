# SPDX-License-Identifier: MIT
"""Fields of a label space from data in the form of SemanticKITTI's yaml."""

from collections.abc import Iterable, Mapping
from itertools import chain, islice
from typing import Any

import numpy as np

from salsanext_cli.errors import UsageError, shortened

RAW_ID_COUNT = 1 << 16
UNKNOWN = 255
SHOWN_IDS = 20
"""Number of ids in an error, and of digits of each."""
ALTERNATIVES = "learning_alternatives"
KEYS = (
    *("labels", "learning_map", "learning_map_inv", "learning_ignore", "color_map", "split"),
    ALTERNATIVES,
)


def read_fields(data: Mapping[str, Any], source: object) -> dict[str, Any]:
    """Return the fields of a `LabelSpace`, checked."""
    try:
        labels = {int(i): str(name) for i, name in data["labels"].items()}
        learning_map = {int(i): int(train) for i, train in data["learning_map"].items()}
        inverse = {int(train): int(i) for train, i in data["learning_map_inv"].items()}
        ignore = {
            int(train): bool(flag) for train, flag in data.get("learning_ignore", {0: True}).items()
        }
        alternatives = {
            int(i): tuple(sorted({int(train) for train in _list(several)}))
            for i, several in data.get(ALTERNATIVES, {}).items()
        }
        colours = {int(i): _colour(bgr) for i, bgr in data.get("color_map", {}).items()}
        splits = {
            str(name): tuple(_sequence_name(s) for s in _list(members))
            for name, members in data.get("split", {}).items()
        }
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        found = f"not a label space: {shortened(error)}"
        raise UsageError(source, found, f"keys {', '.join(KEYS)}") from error
    if problem := _contradiction(labels, learning_map, inverse, alternatives):
        raise UsageError(source, problem, "a consistent label space")
    ids = range(len(inverse))
    bgr = [colours.get(inverse[i], _spare_colour(i)) for i in ids]
    return {
        "name": str(data.get("name", getattr(source, "stem", source))),
        "labels": labels,
        "learning_map": learning_map,
        "learning_map_inv": inverse,
        "ignored": tuple(ignore.get(i, i == 0) for i in ids),
        "colours": np.array([colour[::-1] for colour in bgr], np.uint8),
        "splits": splits,
        "alternatives": alternatives,
    }


def _contradiction(
    labels: dict[int, str],
    learning_map: dict[int, int],
    inverse: dict[int, int],
    alternatives: dict[int, tuple[int, ...]],
) -> str:
    """Return a description of an inconsistency, empty without one."""
    if not inverse or sorted(inverse) != list(range(len(inverse))) or len(inverse) > UNKNOWN:
        return f"train ids {_some(inverse)} are not 0…C-1 with C ≤ {UNKNOWN}"
    if bad := [i for i in (*learning_map, *labels) if not 0 <= i < RAW_ID_COUNT]:
        return f"raw ids {_some(bad)} do not fit 16 bits"
    if bad := sorted(set(learning_map.values()) - set(inverse)):
        return f"learning_map leads to train ids {_some(bad)} that learning_map_inv lacks"
    if bad := sorted(set(inverse.values()) - set(labels)):
        return f"raw ids {_some(bad)} have no name in labels"
    if bad := sorted({*chain(*alternatives.values())} - set(inverse)):
        return f"{ALTERNATIVES} lead to train ids {_some(bad)} that learning_map_inv lacks"
    if bad := [i for i, several in alternatives.items() if learning_map.get(i) not in several]:
        return f"{ALTERNATIVES} of raw ids {_some(bad)} lack the train id of their learning_map"
    return ""


def _some(ids: Iterable[int]) -> str:
    """Return a short list of the first ids, for any number and size of them."""
    listed = sorted(ids)
    shown = [shortened(i, SHOWN_IDS) for i in listed[:SHOWN_IDS]]
    return f"[{', '.join([*shown, '…'] if len(listed) > SHOWN_IDS else shown)}]"


def _list(members: object) -> list[Any]:
    if not isinstance(members, list | tuple):
        raise TypeError(f"{shortened(members)} is not a list")
    return list(members)


def _sequence_name(sequence: object) -> str:
    """Return the name of a sequence's folder: numbers get two digits."""
    return f"{sequence:02d}" if isinstance(sequence, int) else str(sequence)


def _colour(channels: Any) -> list[int]:
    """Return the three bytes of a colour; anything else raises `ValueError`."""
    colour = [int(channel) for channel in islice(channels, 4)]
    if len(colour) != 3 or not all(0 <= channel <= 255 for channel in colour):
        raise ValueError(f"{shortened(channels)} is not a colour of 3 bytes")
    return colour


def _spare_colour(train_id: int) -> list[int]:
    """Return a stable blue, green, red for a class without a colour; unlabelled is black."""
    return [0, 0, 0] if train_id == 0 else [(train_id * step) % 206 + 50 for step in (67, 109, 151)]
