# SPDX-License-Identifier: MIT
"""Run folder of a training: its files, and the settings that decide what is in them."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.device import PRECISIONS
from salsanext_cli.errors import OutputError, counted
from salsanext_cli.files.atomic import require_writable
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.json_files import record_of
from salsanext_cli.results.manifest import (
    Manifest,
    StageRecord,
    require_same_settings,
    settings_json,
)
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.sensors.sensor import Sensor
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import REMOVED, Recipe

STAGE = "train"
CHECKPOINT = "checkpoint.safetensors"
LAST, BEST = "last.safetensors", "best.safetensors"
LOG, CURVE = "log.csv", "curve.png"
RECIPE, CLASS_COUNTS = "recipe.toml", "class_counts.json"
SAMPLES, EVENTS, FOLDS, STREETS = "samples", "tensorboard", "folds", "streets"
RESULTS = (CHECKPOINT, BEST, LAST, LOG, CURVE)
"""Files that a new training in the folder removes, beside pictures and events."""


@dataclass(frozen=True, slots=True)
class FurtherData:
    """Scans of another data set that are trained on too."""

    label_space: LabelSpace
    scans: str  # As of `scans_digest`


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings that decide the result of a training."""

    recipe: Recipe
    sensor: Sensor
    label_space: LabelSpace
    scans: str  # As of `scans_digest`, of those trained on and for validation
    weights: str | None = None  # SHA-256 of the weights that it begins from
    labels: str | None = None  # Digest of the labels of a cross-validated training
    also: tuple[FurtherData, ...] | None = None
    left_out: str | None = None  # Of a fold: `scans_digest` of its scans

    @property
    def decisive(self) -> dict[str, object]:
        """Settings that a resumed training keeps; the parts of a batch may change."""
        recipe = replace(self.recipe, accumulate=Recipe().accumulate)
        return settings_json(replace(self, recipe=recipe))

    @property
    def recipe_file(self) -> bytes:
        """Content of the file of the recipe in the run folder."""
        return self.recipe.to_toml().encode()


def training_settings(
    recipe: Recipe, sources: Sequence[Source], weights: Path | None
) -> TrainingSettings:
    """Return all that decides a training's result; sources: trained on, validated, further ones."""
    first, validation, *further = sources
    labels = None
    if first.files and recipe.folds:
        # Labels of a few scans are corrected, and trained on again.
        digests = "".join(fingerprint(file.label_path) for file in first.files)
        labels = hashlib.sha256(digests.encode()).hexdigest()[:16]
    return TrainingSettings(
        recipe=recipe,
        sensor=replace(first.sensor, intensity_quantiles=(), row_gaps=None),
        label_space=first.space,
        scans=scans_digest([*first.files, *validation.files]),
        weights=fingerprint(weights) if weights else None,
        labels=labels,
        also=tuple(FurtherData(s.space, scans_digest(s.files)) for s in further) or None,
    )


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


def recorded_settings(run: Path) -> TrainingSettings | None:
    """Return the settings of the training that a folder holds, None if it holds none."""
    manifest = Manifest(run)
    if (record := manifest.record(STAGE)) is None:
        return None
    path, recipe = manifest.path(STAGE), record.settings.get("recipe")
    if isinstance(recipe, dict) and (gone := [key for key in REMOVED if recipe.get(key)]):
        found = f"a training of an older version with {gone[0]} {recipe[gone[0]]}"
        raise OutputError(path, found, hint="use another folder, or --overwrite to start again")
    return record_of(TrainingSettings, record.settings, path)


def recorded_precision(run: Path) -> str | None:
    """Return the number type of the training that a folder holds, None if it tells none."""
    settings = recorded_settings(run)
    precision = settings.recipe.precision if settings else None
    return precision if precision in PRECISIONS and precision != "auto" else None


def require_free(run: Path, settings: TrainingSettings, *, overwrite: bool) -> None:
    """Refuse, before anything is done, a folder that a training may not have."""
    require_writable(run)
    recorded, owned = None if overwrite else recorded_settings(run), OwnedFolder(run, STAGE)
    replaced = [run / name for name in (*RESULTS, CLASS_COUNTS)]
    replaced += [sample_path(run, epoch) for epoch in range(1, settings.recipe.epochs + 1)]
    if not _holds_recipe(run, settings):
        replaced.append(run / RECIPE)
    owned.refuse_foreign(replaced)
    results = (folder / name for folder in _folders(run) for name in RESULTS)
    if recorded is None or overwrite or not any(path.exists() for path in results):
        return
    before, after = _extended(recorded, settings).decisive, settings.decisive
    if before != after and _extended(recorded, settings, always=True).decisive == after:
        found = f"{counted(recorded.recipe.epochs, 'epoch')}, and a schedule that has ended"
        hint = f"go on from it in another folder: --weights {run / LAST}"
        raise OutputError(owned.record_path, found, "a schedule that goes on: decay", hint)
    require_same_settings(owned.record_path, before, after)


def begin(run: Path, settings: TrainingSettings, *, overwrite: bool) -> None:
    """Record a training in a free folder; remove results of other settings, or all to overwrite."""
    recorded, owned = None if overwrite else recorded_settings(run), OwnedFolder(run, STAGE)
    known = recorded and _extended(recorded, settings).decisive
    if overwrite or known != settings.decisive:
        for folder in _folders(run):
            results = [folder / name for name in RESULTS]
            results += [*folder.glob(f"{SAMPLES}/epoch-*.png"), *folder.glob(f"{EVENTS}/events.*")]
            OwnedFolder(folder).remove_written(results)
    owned.manifest.write(StageRecord(STAGE, settings_json(settings)))
    if not _holds_recipe(run, settings):
        owned.write(run / RECIPE, settings.recipe_file)


def _folders(run: Path) -> list[Path]:
    """Return the run folder, and those of its folds."""
    return [run, *run.glob(f"{FOLDS}/*")]


def _holds_recipe(run: Path, settings: TrainingSettings) -> bool:
    with suppress(OSError):
        return (run / RECIPE).read_bytes() == settings.recipe_file
    return False


def _extended(
    recorded: TrainingSettings, wanted: TrainingSettings, *, always: bool = False
) -> TrainingSettings:
    """Return recorded settings, with more epochs if those before stay the same."""
    recipe = wanted.recipe
    steady = recipe.schedule == "decay" and not recipe.folds
    if (steady or always) and recorded.recipe.epochs < recipe.epochs:
        return replace(recorded, recipe=replace(recorded.recipe, epochs=recipe.epochs))
    return recorded
