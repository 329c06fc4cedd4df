# SPDX-License-Identifier: MIT
"""Differences of recorded settings from others, by the names of arguments."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.device import arithmetic_in, is_int8
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
    """Describe how recorded settings differ from others, arguments first; empty if they do not.

    Scales of values that only one of both has are no difference: they extend the record.
    """
    before = dict(_flat(recorded))
    after = dict(_flat(settings))
    common = before.keys() & after.keys()
    compared = [key for key in before.keys() | after if key in common or not _is_scale(key)]
    changed = sorted(key for key in compared if before.get(key) != after.get(key))
    causes = [key for key in changed if key.partition(".")[0] not in DERIVED] or changed
    ordered = sorted(causes, key=lambda key: (key not in ARGUMENT_OF and key != "objects", key))
    return first_few([_difference(key, before.get(key), after.get(key)) for key in ordered])


def with_new_scales(
    recorded: Mapping[str, object], settings: Mapping[str, object]
) -> Mapping[str, object]:
    """Return recorded settings with the scales of values that had none before."""
    scales = settings.get("scales")
    if not isinstance(scales, dict):
        return recorded
    earlier = recorded.get("scales")
    return {**recorded, "scales": scales | (earlier if isinstance(earlier, dict) else {})}


def _is_scale(key: str) -> bool:
    """Return whether a setting is the scale of one of several values."""
    return key.startswith("scales.")


def _difference(key: str, before: Any, after: Any) -> str:
    """Describe how a setting differs, in lists of equal length by the first differing value."""
    if key == "sensor.intensity_quantiles":
        return _change_of_intensity(before, after)
    if key == "sensor.ego_box":
        change = f"the box of the vehicle was {_box_text(before)} and is {_box_text(after)}"
        return f"{change} ({argument('ego')})"
    if key == "precision" and is_int8(before) and is_int8(after):
        cpus = f"was computed with {arithmetic_in(before)}, and this CPU has {arithmetic_in(after)}"
        return f"int8 {cpus}"  # No option changes the CPU
    if key.startswith("origins."):
        return f"`{key.removeprefix('origins.')}` has replaced its results since"
    if isinstance(before, dict) and isinstance(after, dict):
        return _change_of_classes(key, before, after)
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        index = next(i for i, value in enumerate(before) if value != after[i])
        key = f"{key}[{index}]"
        before = before[index]
        after = after[index]
    name = key.removeprefix("sensor.")
    change = f"{name} was {_value_text(before)} and is {_value_text(after)}"
    if key == "objects":
        return f"{change} ({setting('extras', ('objects',))})"
    return f"{change} ({argument(ARGUMENT_OF[key])})" if key in ARGUMENT_OF else change


def _change_of_intensity(before: Any, after: Any) -> str:
    """Describe how the treatment of the intensity differs, by its quantiles."""
    old = _intensity_text(before)
    new = _intensity_text(after)
    if new == old:
        new = "matched to other scans"
    return f"intensity was {old} and is {new} ({argument('intensity')})"


def _intensity_text(quantiles: list[float] | None) -> str:
    """Return how the intensity was treated, as its option takes it."""
    if not quantiles:
        return "raw"
    return "matched" if any(quantiles) else "none"


def _box_text(box: list[float] | None) -> str:
    """Return the box of a vehicle as its option takes it."""
    return ",".join(f"{limit:g}" for limit in box or ()) or "no box"


def _value_text(value: object) -> str:
    """Return a value as JSON."""
    return "not set" if value is None else shortened(json.dumps(value, ensure_ascii=False), 40)


def _change_of_classes(key: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Describe how two label spaces differ."""
    old = LabelSpace.from_dict(before, key)
    new = LabelSpace.from_dict(after, key)
    if old.names != new.names:
        return f"the classes were {old.name} and are {new.name} ({argument('classes')})"
    return f"{key} ({first_few(old.differences(new))})"


def _flat(settings: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield dotted keys and values that are set; a label space stays whole."""
    for key, value in settings.items():
        if isinstance(value, dict) and key != "label_space":
            yield from _flat(value, f"{prefix}{key}.")
        elif value is not None:
            yield prefix + key, value
