# SPDX-License-Identifier: MIT
"""What an output folder remembers of each stage: its settings, and which results are its own."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from salsanext_cli import __version__
from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import OutputError
from salsanext_cli.sensors import Sensor, sensor
from salsanext_cli.storage.json_files import read_json, write_json
from salsanext_cli.storage.layout import SUFFIX_OF_FOLDER
from salsanext_cli.storage.recorded_settings import Settings

SHOWN = 3
"""How many differences an error names."""
RESULT_STAGES = ("project", "predict", "knn-refine", "uncertainty", "export-ply")


def stage_settings(out: Path, stage: str) -> Settings | None:
    """Return the settings a stage ran with in this output folder, None if it did not."""
    manifest = manifest_of(out, stage)
    return None if manifest is None else Settings(manifest["settings"], out / f"{stage}.json")


def owner(out: Path, folder: str) -> str | None:
    """Return the stage that writes a folder of results in this output folder, if any does."""
    for stage in RESULT_STAGES:
        manifest = manifest_of(out, stage)
        if manifest and folder in manifest["writes"]:
            return stage
    return None


def origins(out: Path, stages: Iterable[str]) -> dict[str, str]:
    """Return a digest of the settings of each of the stages that ran in this output folder.

    A stage that reads their results records it, so as not to keep what it made of older ones.
    """
    settings = {stage: stage_settings(out, stage) for stage in stages}
    return {
        stage: hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:12]
        for stage, values in settings.items()
        if values is not None
    }


def manifest_of(out: Path, stage: str) -> dict[str, Any] | None:
    """Return what `record` wrote of a stage, None if it did not run here."""
    path = out / f"{stage}.json"
    manifest = read_json(path)
    kinds = {"settings": dict, "writes": list}
    if manifest is not None and not (
        all(isinstance(manifest.get(k), kind) for k, kind in kinds.items())
        and all(folder in [*SUFFIX_OF_FOLDER] for folder in manifest["writes"])
    ):
        found = f"not what `{stage}` writes"
        raise OutputError(path, found, remedy="delete it or use another folder")
    return manifest


def record(out: Path, stage: str, settings: Mapping[str, Any], writes: Sequence[str]) -> None:
    """Write `OUT/<stage>.json`: what a stage does, and which folders of results it fills."""
    manifest = {"stage": stage, "version": __version__, "settings": settings, "writes": [*writes]}
    write_json(out / f"{stage}.json", manifest)


def require_same_settings(
    path: Path,
    recorded: Mapping[str, Any],
    settings: Mapping[str, Any],
    remedy: str = "use another output folder, or --overwrite to replace all its results",
) -> None:
    """Refuse to mix or to replace what was made with other settings, and say which."""
    if recorded != settings:
        found = f"made with other settings: {_differences(recorded, settings)}"
        raise OutputError(path, found, remedy=remedy)


def as_json(settings: Any) -> Any:
    """Return settings as they are read back: lists for tuples, strings for keys."""
    # JSON has no number for an infinite cutoff.
    return json.loads(json.dumps(settings), parse_constant=str)


def recorded_label_space(out: Path) -> LabelSpace | None:
    """Return the label space of the predictions in an output folder, if a stage recorded one."""
    stage = owner(out, "predictions") or owner(out, "pixel_labels")
    settings = stage_settings(out, stage) if stage else None
    if settings is None:
        return None
    return LabelSpace.from_dict(settings.table("label_space"), settings.path)


def recorded_weights(out: Path, folder: str) -> str | None:
    """Return the SHA-256 of the weights behind a folder of results, None if nobody recorded it."""
    stage = owner(out, folder)
    settings: Mapping[str, Any] = (stage_settings(out, stage) if stage else None) or {}
    if stage == "knn-refine" and settings.get("labels") is None:
        return recorded_weights(out, "pixel_labels")
    found = settings.get("weights")
    return None if found is None else str(found)


def recorded_sensor(out: Path) -> Sensor:
    """Return the sensor that labels in an output folder were made through; else the HDL-64."""
    for folder in ("pixel_labels", "predictions", "uncertainty/epistemic", "range"):
        stage = owner(out, folder)
        settings = stage_settings(out, stage) if stage else None
        if settings is not None:
            return Sensor.from_dict(settings.table("sensor"), settings.path)
    return sensor("hdl64")


def _differences(recorded: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    """Name what differs, key by key, and how; origins are named without their digests."""
    before, after = _flat(recorded), _flat(settings)
    changed = sorted(k for k in before.keys() | after if before.get(k) != after.get(k))
    shown = [
        f"what `{key.removeprefix('origins.')}` made was made anew"
        if key.startswith("origins.")
        else f"{key} was {_short(before.get(key))} and is {_short(after.get(key))}"
        for key in changed[:SHOWN]
    ]
    more = len(changed) - len(shown)
    return ", ".join(shown) + (f", and {more} more" if more else "")


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings by dotted key."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        flat |= (
            _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
        )
    return flat


def _short(value: object, length: int = 40) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= length else text[: length - 1] + "…"
