# SPDX-License-Identifier: MIT
"""Run folder of a training: its files, and the settings that decide what is in them."""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.engines.device import PRECISIONS
from salsanext_cli.errors import OutputError, counted
from salsanext_cli.files.atomic import require_writable
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.stage_records import (
    StageRecord,
    StageRecords,
    as_json,
    require_same_settings,
)
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe

STAGE = "train"
CHECKPOINT = "checkpoint.safetensors"
LAST, BEST = "last.safetensors", "best.safetensors"
LOG, CURVE = "log.csv", "curve.png"
RECIPE, CLASS_COUNTS = "recipe.toml", "class_counts.json"
SAMPLES, EVENTS, FOLDS, STREETS = "samples", "tensorboard", "folds", "streets"
RESULTS = (CHECKPOINT, BEST, LAST, LOG, CURVE)
"""Files that a new training in the folder removes, beside pictures and events."""


def training_settings(
    recipe: Recipe, sources: Sequence[Source], weights: Path | None
) -> dict[str, Any]:
    """Return all that decides a training's result; sources: trained on, validated, further ones."""
    first, validation, *further = sources
    settings: dict[str, Any] = {
        "recipe": recipe.to_dict(),
        "sensor": replace(first.sensor, intensity_quantiles=(), row_gaps=None).to_dict(),
        "label_space": first.space.to_dict(),
        "scans": scans_digest([*first.files, *validation.files]),
        "weights": fingerprint(weights) if weights else None,
    }
    if first.files and recipe.folds:
        # Labels of a few scans are corrected, and trained on again.
        labels = "".join(fingerprint(file.label_path) for file in first.files)
        settings["labels"] = hashlib.sha256(labels.encode()).hexdigest()[:16]
    if further:
        settings["also"] = [
            {"label_space": each.space.to_dict(), "scans": scans_digest(each.files)}
            for each in further
        ]
    return settings


def scans_digest(scans: Sequence[ScanFile]) -> str:
    """Return the number of scans and a digest of their names."""
    names = "\n".join(scan.name for scan in scans)
    return f"{len(scans)}, {hashlib.sha256(names.encode()).hexdigest()[:16]}"


def sample_path(run: Path, epoch: int) -> Path:
    """Return where the picture of a validated scan after an epoch lies."""
    return run / SAMPLES / f"epoch-{epoch:03d}.png"


def fold_folder(run: Path, number: int) -> Path:
    """Return the folder, itself one of a training, of a fold of a cross-validation, from 1."""
    return run / FOLDS / str(number)


def recorded_precision(run: Path) -> str | None:
    """Return the number type of the training that a folder holds, None if it tells none."""
    settings = StageRecords(run).settings(STAGE)
    precision = settings.table("recipe").get("precision") if settings else None
    return precision if precision in PRECISIONS and precision != "auto" else None


def require_free(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Refuse, before anything is done, a folder that a training may not have."""
    require_writable(run)
    recorded = StageRecords(run).settings(STAGE)
    replaced = [run / name for name in (*RESULTS, CLASS_COUNTS)]
    epochs = settings["recipe"]["epochs"]
    replaced += [sample_path(run, epoch) for epoch in range(1, epochs + 1)]
    if not _holds_recipe(run, settings):
        replaced.append(run / RECIPE)
    owned = OwnedFolder(run, STAGE)
    owned.require_own(replaced)
    results = (folder / name for folder in _folders(run) for name in RESULTS)
    if recorded is not None and not overwrite and any(path.exists() for path in results):
        decisive = _decisive(as_json(settings))
        before = _extended(recorded, decisive)
        if before != decisive and _extended(recorded, decisive, always=True) == decisive:
            found = f"{counted(before['recipe']['epochs'], 'epoch')}, and a schedule that has ended"
            remedy = f"go on from it in another folder: --weights {run / 'last.safetensors'}"
            raise OutputError(owned.record_path, found, "a schedule that goes on: decay", remedy)
        require_same_settings(owned.record_path, before, decisive)


def begin(run: Path, settings: Mapping[str, Any], *, overwrite: bool) -> None:
    """Record a training in a free folder; remove results of other settings, or all to overwrite."""
    recorded, owned = StageRecords(run).settings(STAGE), OwnedFolder(run, STAGE)
    decisive = _decisive(as_json(settings))
    if overwrite or recorded is None or _extended(recorded, decisive) != decisive:
        for folder in _folders(run):
            results = [folder / name for name in RESULTS]
            results += [*folder.glob(f"{SAMPLES}/epoch-*.png"), *folder.glob(f"{EVENTS}/events.*")]
            OwnedFolder(folder).remove_own(results)
    owned.begin(StageRecord(STAGE, as_json(settings)).to_dict())
    if not _holds_recipe(run, settings):
        owned.write(run / RECIPE, _recipe_file(settings))


def _folders(run: Path) -> list[Path]:
    """Return the run folder, and those of its folds."""
    return [run, *run.glob(f"{FOLDS}/*")]


def _recipe_file(settings: Mapping[str, Any]) -> bytes:
    return Recipe.from_dict(settings["recipe"]).to_toml().encode()


def _holds_recipe(run: Path, settings: Mapping[str, Any]) -> bool:
    with suppress(OSError):
        return (run / RECIPE).read_bytes() == _recipe_file(settings)
    return False


def _extended(
    recorded: Mapping[str, Any], decisive: Mapping[str, Any], *, always: bool = False
) -> dict[str, Any]:
    """Return the decisive settings of a record, with more epochs if those before stay the same."""
    before, recipe = _decisive(recorded), decisive["recipe"]
    steady = recipe["schedule"] == "decay" and not recipe["folds"]
    if (steady or always) and before.get("recipe", recipe)["epochs"] < recipe["epochs"]:
        before["recipe"] = {**before["recipe"], "epochs": recipe["epochs"]}
    return before


def _decisive(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that a resumed training keeps; the parts of a batch may change."""
    recipe = settings.get("recipe")
    if not isinstance(recipe, dict):
        return dict(settings)
    defaults = Recipe().to_dict()
    # A key that this version no longer has changed nothing where it was 0.
    known = {key: value for key, value in recipe.items() if key in defaults or value}
    return {**settings, "recipe": {**defaults, **known, "accumulate": None}}
