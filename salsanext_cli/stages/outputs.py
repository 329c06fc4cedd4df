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
from salsanext_cli.formats.json_files import read_json, write_json
from salsanext_cli.formats.layout import SUFFIX_OF_FOLDER, ScanFile, find_outputs
from salsanext_cli.sensors import Sensor, sensor
from salsanext_cli.stages.settings import Settings
from salsanext_cli.stages.sources import new_sources

SHOWN = 3
"""How many differences an error names."""
RESULT_STAGES = ("project", "predict", "knn-refine", "uncertainty", "export-ply")


def stage_settings(out: Path, stage: str) -> Settings | None:
    """Return the settings a stage ran with in this output folder, None if it did not."""
    manifest = _manifest(out, stage)
    return None if manifest is None else Settings(manifest["settings"], out / f"{stage}.json")


def owner(out: Path, folder: str) -> str | None:
    """Return the stage that writes a folder of results in this output folder, if any does."""
    for stage in RESULT_STAGES:
        manifest = _manifest(out, stage)
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


def _manifest(out: Path, stage: str) -> dict[str, Any] | None:
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


def claim(
    out: Path,
    stage: str,
    settings: Mapping[str, Any],
    writes: Iterable[str],
    scans: Sequence[ScanFile] = (),
    *,
    overwrite: bool,
) -> None:
    """Record what a stage does in `OUT/<stage>.json`, or refuse to mix results.

    Parameters
    ----------
    out : Path
        The output folder.
    stage : str
        Its name on the command line.
    settings : mapping
        Resolved settings, JSON-able, that decide what the results are.
    writes : iterable of str
        The folders of results that the stage fills.
    scans : sequence of ScanFile
        What it works on; that, and where they came from, is remembered for later stages.
    overwrite : bool
        Whether other settings may replace those recorded; results made with them are removed.

    Raises
    ------
    OutputError
        If the folder holds results of other settings, or of another stage, and `overwrite` is
        not set; if a sequence of the same name came from elsewhere; or if it cannot be written.
    """
    folders = sorted(writes)
    settings = as_json(settings)
    manifest = _manifest(out, stage) or {}
    recorded = manifest.get("settings", settings)
    sources = new_sources(out, scans, stage, anew=recorded != settings)
    if recorded == settings:
        folders = sorted({*folders, *manifest.get("writes", ())})
    else:
        if not overwrite:
            require_same_settings(out / f"{stage}.json", recorded, settings)
        _remove_results(out, manifest["writes"])
    for folder in folders:
        _take_over(out, folder, stage, overwrite)
        if not manifest and not overwrite:
            _require_none(out, folder)
    manifest = {"stage": stage, "version": __version__, "settings": settings, "writes": folders}
    write_json(out / f"{stage}.json", manifest)
    for path, record in sources.items():
        write_json(path, record)


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


def _take_over(out: Path, folder: str, stage: str, overwrite: bool) -> None:
    other = owner(out, folder)
    if other in (None, stage):
        return
    path = out / f"{other}.json"
    if not overwrite:
        raise OutputError(
            path,
            f"{folder}/ holds the results of `{other}`",
            remedy="use another output folder, or --overwrite to replace them",
        )
    _remove_results(out, [folder])
    manifest = read_json(path) or {}
    write_json(path, manifest | {"writes": [name for name in manifest["writes"] if name != folder]})


def _require_none(out: Path, folder: str) -> None:
    """Refuse results that no stage of ours recorded: nobody knows how they were made."""
    if owner(out, folder) is None and (found := find_outputs(out, folder)):
        raise OutputError(
            found[0].path,
            "was there before, made nobody knows how",
            remedy="use another output folder, or --overwrite to replace it",
        )


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


def _remove_results(out: Path, folders: Iterable[str]) -> None:
    """Remove what was made with settings that no longer hold: only files that stages write."""
    for folder in folders:
        for result in find_outputs(out, folder):
            result.path.unlink(missing_ok=True)
