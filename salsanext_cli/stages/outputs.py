# SPDX-License-Identifier: MIT
"""What an output folder remembers: settings of each stage, and where the scans came from."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from salsanext_cli import __version__
from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import NoInputError, OutputError
from salsanext_cli.formats.atomic import write_text
from salsanext_cli.formats.layout import SUFFIX_OF_FOLDER, ScanFile, find_outputs, find_scans
from salsanext_cli.formats.reading import reading
from salsanext_cli.sensors import Sensor, sensor

SOURCE = "source.json"
RESULT_STAGES = ("project", "predict", "knn-refine", "uncertainty", "export-ply")


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write plain data as JSON, atomically."""
    write_text(path, json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any] | None:
    """Read what `write_json` wrote; None if there is no such file.

    Raises
    ------
    OutputError
        If the file is damaged.
    """
    if not path.exists():
        return None
    with reading(path) as file:
        text = file.read()
    try:
        data = json.loads(text)
    except ValueError as error:
        raise OutputError(path, "damaged", "JSON", "delete it or use another folder") from error
    if not isinstance(data, dict):
        raise OutputError(path, "damaged", "a JSON object", "delete it or use another folder")
    return data


def stage_settings(out: Path, stage: str) -> dict[str, Any] | None:
    """Return the settings a stage ran with in this output folder, None if it did not."""
    manifest = read_json(out / f"{stage}.json")
    return None if manifest is None else dict(manifest.get("settings", {}))


def owner(out: Path, folder: str) -> str | None:
    """Return the stage that writes a folder of results in this output folder, if any does."""
    for stage in RESULT_STAGES:
        manifest = read_json(out / f"{stage}.json")
        if manifest and folder in manifest.get("writes", ()):
            return stage
    return None


def claim(
    out: Path, stage: str, settings: Mapping[str, Any], writes: Iterable[str], *, overwrite: bool
) -> None:
    """Record the settings of a stage in `OUT/<stage>.json`, or refuse to mix results.

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
    overwrite : bool
        Whether other settings may replace those recorded; results made with them are removed.

    Raises
    ------
    OutputError
        If the folder holds results of other settings, or of another stage, and `overwrite` is
        not set; or if it cannot be written.
    """
    folders = sorted(writes)
    settings = json.loads(json.dumps(settings))
    manifest = read_json(out / f"{stage}.json") or {}
    recorded = manifest.get("settings", settings)
    if recorded == settings:
        folders = sorted({*folders, *manifest.get("writes", ())})
    else:
        if not overwrite:
            raise OutputError(
                out / f"{stage}.json",
                f"made with other settings: {_differences(recorded, settings)}",
                remedy="use another output folder, or --overwrite to replace all its results",
            )
        _remove_results(out, manifest["writes"])
    for folder in folders:
        _take_over(out, folder, stage, overwrite)
    manifest = {"stage": stage, "version": __version__, "settings": settings, "writes": folders}
    write_json(out / f"{stage}.json", manifest)


def recorded_label_space(out: Path) -> LabelSpace | None:
    """Return the label space of the predictions in an output folder, if a stage recorded one."""
    stage = owner(out, "predictions") or owner(out, "pixel_labels")
    settings = stage_settings(out, stage) if stage else None
    return (
        LabelSpace.from_dict(settings["label_space"], out / f"{stage}.json") if settings else None
    )


def recorded_sensor(out: Path) -> Sensor:
    """Return the sensor that the stages in an output folder looked through; else the HDL-64."""
    for stage in RESULT_STAGES:
        settings = stage_settings(out, stage)
        if settings and "sensor" in settings:
            return Sensor.from_dict(settings["sensor"], out / f"{stage}.json")
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


def _differences(recorded: Mapping[str, Any], settings: Mapping[str, Any]) -> str:
    changed = sorted(
        key for key in recorded.keys() | settings if recorded.get(key) != settings.get(key)
    )
    return ", ".join(
        f"{key} was {_short(recorded.get(key))} and is {_short(settings.get(key))}"
        for key in changed
    )


def _short(value: object, length: int = 60) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= length else text[: length - 1] + "…"


def _remove_results(out: Path, folders: Iterable[str]) -> None:
    """Remove what was made with settings that no longer hold: only files that stages write."""
    for folder in folders:
        for result in find_outputs(out, folder):
            result.path.unlink(missing_ok=True)


def remember_sources(out: Path, scans: Sequence[ScanFile]) -> None:
    """Record for each sequence which folder its scans came from.

    Raises
    ------
    OutputError
        If a sequence of that name came from another folder: the results would overwrite each
        other.
    """
    for sequence, folder in sorted({(scan.sequence, scan.path.parent) for scan in scans}):
        path = out / "sequences" / sequence / SOURCE
        recorded = (read_json(path) or {}).get("scans")
        if recorded not in (None, str(folder)):
            raise OutputError(
                path,
                f"sequence {sequence} came from {recorded}",
                f"scans from there, not from {folder}",
                "use another output folder",
            )
        if recorded is None:
            write_json(path, {"scans": str(folder)})


def remembered_scans(out: Path, dataset: Path | None = None) -> list[ScanFile]:
    """Find the scans whose results an output folder holds.

    Parameters
    ----------
    out : Path
        The output folder.
    dataset : Path, optional
        Where to look instead of where the scans came from.

    Raises
    ------
    NoInputError
        If there is no such folder, it holds no results, or a sequence's scans are not to be found.
    """
    sequences = sorted(
        {file.sequence for folder in SUFFIX_OF_FOLDER for file in find_outputs(out, folder)}
    )
    if not sequences:
        found = "holds no results" if out.is_dir() else "no such folder"
        remedy = f"run `salsanext predict SCANS {out}` first"
        raise NoInputError(out, found, "the output folder of an earlier stage", remedy)
    return [scan for name in sequences for scan in _scans_of_sequence(out, name, dataset)]


def _scans_of_sequence(out: Path, sequence: str, dataset: Path | None) -> list[ScanFile]:
    recorded = (read_json(out / "sequences" / sequence / SOURCE) or {}).get("scans")
    if dataset is None and recorded and Path(recorded).is_dir():
        return find_scans(Path(recorded))
    root = dataset or Path()
    if (root / "sequences").is_dir():
        return find_scans(root, [sequence])
    raise NoInputError(
        out / "sequences" / sequence,
        f"its scans are not in {recorded or root.absolute()}",
        "the folder that they came from",
        "say with --dataset where the data set is",
    )
