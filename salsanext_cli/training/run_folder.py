# SPDX-License-Identifier: MIT
"""Run folder of a training: its files, its settings, its lock, and whose files lie in it."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from salsanext_cli.engines.device import PRECISIONS
from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import require_writable, sweep_stale
from salsanext_cli.files.locks import locked
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.stage_records import (
    StageRecord,
    as_json,
    require_same_settings,
    stage_settings,
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

log = logging.getLogger(__name__)


def sample_path(run: Path, epoch: int) -> Path:
    """Return where the picture of a validated scan after an epoch lies."""
    return run / SAMPLES / f"epoch-{epoch:03d}.png"


def fold_folder(run: Path, number: int) -> Path:
    """Return the folder, itself one of a training, of a fold of a cross-validation, from 1."""
    return run / FOLDS / str(number)


@contextmanager
def trained_alone(run: Path) -> Iterator[None]:
    """Keep other trainings out of a folder while the body runs.

    Temporary files of a training that was killed long ago are removed.
    """
    with locked(run / f".{STAGE}.lock", stage=STAGE):
        for folder in _folders(run):
            sweep_stale(folder)
            sweep_stale(folder / SAMPLES)
        yield


def require_free(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Refuse, before anything is done, a folder that a training may not have."""
    require_writable(run)
    recorded = stage_settings(run, STAGE)
    epochs = as_json(settings)["recipe"]["epochs"]
    replaced = [run / name for name in (*RESULTS, RECIPE, CLASS_COUNTS)]
    replaced += [sample_path(run, epoch) for epoch in range(1, epochs + 1)]
    for path in OwnedFolder(run).others(replaced):
        if path.name != RECIPE or _content(path) != _recipe_file(settings):
            found = "not written by salsanext, or changed since"
            raise OutputError(path, found, remedy="move it, or use another folder")
    results = (folder / name for folder in _folders(run) for name in RESULTS)
    if recorded is not None and not overwrite and any(path.exists() for path in results):
        path = run / f"{STAGE}.json"
        require_same_settings(path, _decisive(recorded), _decisive(as_json(settings)))


def recorded_precision(run: Path) -> str | None:
    """Return the number type of the training that a folder holds, None if it tells none."""
    settings = stage_settings(run, STAGE)
    found = settings.table("recipe").get("precision") if settings else None
    return found if found in PRECISIONS and found != "auto" else None


def begin(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Record a training in a folder that is free; results of other settings are removed.

    `run`: the folder; `settings`: all that decides the result of the training, its recipe under
    that name; `overwrite`: whether to begin anew with the same settings too.
    """
    recorded, written = stage_settings(run, STAGE), OwnedFolder(run)
    if overwrite or recorded is None or _decisive(recorded) != _decisive(as_json(settings)):
        for folder in _folders(run):
            results = [folder / name for name in RESULTS]
            results += [*folder.glob(f"{SAMPLES}/epoch-*.png"), *folder.glob(f"{EVENTS}/events.*")]
            for path in OwnedFolder(folder).remove_own(results):
                log.warning("%s is kept: not written by salsanext, or changed since", path)
    StageRecord(STAGE, as_json(settings)).write(run)
    if _content(run / RECIPE) != _recipe_file(settings):
        written.write(run / RECIPE, _recipe_file(settings))


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
