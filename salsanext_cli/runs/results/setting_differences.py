# SPDX-License-Identifier: MIT
"""Differences of recorded settings from others, by the names of arguments."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.texts import first_few, shortened
from salsanext_cli.core.wording import argument, setting

ARGUMENT_OF = {
    "aleatoric": "aleatoric",
    "engine": "engine",
    "knn.cutoff": "knn.cutoff",
    "knn.k": "knn.k",
    "knn.sigma": "knn.sigma",
    "knn.window": "knn.window",
    "label_space": "classes",
    "max_error": "max_error",
    "precision": "precision",
    "reject": "reject",
    "samples": "samples",
    "seed": "seed",
    "sensor.columns": "columns",
    "sensor.ego_box": "ego",
    "sensor.intensity_field": "intensity_field",
    "sensor.intensity_quantiles": "intensity",
    "sensor.min_range": "min_range",
    "sensor.name": "sensor",
    "sensor.width": "width",
    "weights": "weights",
}
"""Argument that sets a recorded setting."""
DERIVED = ("accuracy", "guarantee", "inherited", "reject_by", "temperature", "trained_on")
"""Settings that follow from arguments and weights: they are named only if nothing else differs."""


def differences(recorded: Mapping[str, object], settings: Mapping[str, object]) -> str:
    """Describe how recorded settings differ from others, arguments first; empty if they do not."""
    before = dict(_flat(recorded))
    after = dict(_flat(settings))
    changed = sorted(k for k in before.keys() | after if before.get(k) != after.get(k))
    causes = [key for key in changed if key.partition(".")[0] not in DERIVED] or changed
    ordered = sorted(causes, key=lambda key: (key not in ARGUMENT_OF and key != "objects", key))
    return first_few([_difference(k, before.get(k), after.get(k)) for k in ordered])


def _difference(key: str, before: Any, after: Any) -> str:
    """Describe how a setting differs, in lists of equal length by the first differing value."""
    if key == "sensor.intensity_quantiles":
        was, now = (("matched" if any(q) else "none") if q else "raw" for q in (before, after))
        now = "matched to other scans" if now == was else now
        return f"intensity was {was} and is {now} ({argument('intensity')})"
    if key == "sensor.ego_box":
        was, now = (",".join(f"{v:g}" for v in box or ()) or "no box" for box in (before, after))
        return f"the box of the vehicle was {was} and is {now} ({argument('ego')})"
    if key.startswith("origins."):
        return f"`{key.removeprefix('origins.')}` has replaced its results since"
    if isinstance(before, dict) and isinstance(after, dict):
        old, new = (LabelSpace.from_dict(space, key) for space in (before, after))
        if old.names != new.names:
            return f"the classes were {old.name} and are {new.name} ({argument('classes')})"
        return f"{key} ({first_few(old.differences(new))})"
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        place = next(i for i, value in enumerate(before) if value != after[i])
        key = f"{key}[{place}]"
        before = before[place]
        after = after[place]
    was, now = (
        "not set" if value is None else shortened(json.dumps(value, ensure_ascii=False), 40)
        for value in (before, after)
    )
    change = f"{key.removeprefix('sensor.')} was {was} and is {now}"
    if key == "objects":
        return f"{change} ({setting('extras', ('objects',))})"
    return f"{change} ({argument(ARGUMENT_OF[key])})" if key in ARGUMENT_OF else change


def _flat(settings: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield dotted keys and values that are set; a label space stays whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and key != "label_space":
            yield from _flat(value, f"{prefix}{key}.")
        elif value is not None:
            yield prefix + key, value
