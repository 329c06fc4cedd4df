# SPDX-License-Identifier: MIT
"""Run folder of a training: its files, its settings, and whose files lie in it."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from salsanext_cli.engines.device import PRECISIONS
from salsanext_cli.files.atomic import require_writable
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.stage_records import (
    StageRecord,
    StageRecords,
    as_json,
    require_same_settings,
)
from salsanext_cli.training.recipe import Recipe

STAGE = "train"
CHECKPOINT = "checkpoint.safetensors"
LAST, BEST = "last.safetensors", "best.safetensors"
LOG, CURVE, ERROR = "log.csv", "curve.png", "error.json"
RECIPE, CLASS_COUNTS = "recipe.toml", "class_counts.json"
SAMPLES, EVENTS, FOLDS, STREETS = "samples", "tensorboard", "folds", "streets"
RESULTS = (CHECKPOINT, BEST, LAST, LOG, CURVE, ERROR)
"""Files that a new training in the folder removes, beside pictures and events."""


def sample_path(run: Path, epoch: int) -> Path:
    """Return where the picture of a validated scan after an epoch lies."""
    return run / SAMPLES / f"epoch-{epoch:03d}.png"


def fold_folder(run: Path, number: int) -> Path:
    """Return the folder, itself one of a training, of a fold of a cross-validation, from 1."""
    return run / FOLDS / str(number)


def require_free(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Refuse, before anything is done, a folder that a training may not have."""
    require_writable(run)
    recorded = StageRecords(run).settings(STAGE)
    epochs = as_json(settings)["recipe"]["epochs"]
    replaced = [run / name for name in (*RESULTS, CLASS_COUNTS)]
    replaced += [sample_path(run, epoch) for epoch in range(1, epochs + 1)]
    if _content(run / RECIPE) != _recipe_file(settings):
        replaced.append(run / RECIPE)
    owned = OwnedFolder(run, STAGE)
    owned.require_own(replaced)
    results = (folder / name for folder in _folders(run) for name in RESULTS)
    if recorded is not None and not overwrite and any(path.exists() for path in results):
        require_same_settings(owned.record_path, _decisive(recorded), _decisive(as_json(settings)))


def recorded_precision(run: Path) -> str | None:
    """Return the number type of the training that a folder holds, None if it tells none."""
    settings = StageRecords(run).settings(STAGE)
    found = settings.table("recipe").get("precision") if settings else None
    return found if found in PRECISIONS and found != "auto" else None


def begin(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Record a training in a folder that is free; results of other settings are removed.

    `run`: the folder; `settings`: all that decides the result of the training, its recipe under
    that name; `overwrite`: whether to begin anew with the same settings too.
    """
    recorded, owned = StageRecords(run).settings(STAGE), OwnedFolder(run, STAGE)
    if overwrite or recorded is None or _decisive(recorded) != _decisive(as_json(settings)):
        for folder in _folders(run):
            results = [folder / name for name in RESULTS]
            results += [*folder.glob(f"{SAMPLES}/epoch-*.png"), *folder.glob(f"{EVENTS}/events.*")]
            OwnedFolder(folder).remove_own(results)
    owned.begin(StageRecord(STAGE, as_json(settings)).to_dict())
    if _content(run / RECIPE) != _recipe_file(settings):
        owned.write(run / RECIPE, _recipe_file(settings))


def _folders(run: Path) -> list[Path]:
    """Return the run folder, and those of its folds."""
    return [run, *run.glob(f"{FOLDS}/*")]


def _recipe_file(settings: Mapping[str, Any]) -> bytes:
    return Recipe.from_dict(settings["recipe"]).to_toml().encode()


def _content(path: Path) -> bytes | None:
    with suppress(OSError):
        return path.read_bytes()
    return None


def _decisive(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that may not change when a training is resumed.

    Keys that recipes of older versions lack are the default. The parts of a batch may change, since
    a training that has run out of memory must be able to go on.
    """
    recipe = settings.get("recipe")
    if not isinstance(recipe, dict):
        return dict(settings)
    return {**settings, "recipe": {**Recipe().to_dict(), **recipe, "accumulate": None}}
