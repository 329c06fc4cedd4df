# SPDX-License-Identifier: MIT
"""Run folder of a training: its files, and the settings that determine their content."""

import csv
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.atomic import require_writable
from salsanext_cli.io.files.json_files import record_of
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.runs.annotation.las_classification import labels_source
from salsanext_cli.runs.results.manifest import (
    Manifest,
    StageRecord,
    require_same_settings,
    settings_json,
)
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data.batch_source import WORKERS
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.recipe import Recipe

STAGE = "train"
CHECKPOINT = "checkpoint.safetensors"
LAST = "last.safetensors"
BEST = "best.safetensors"
LOG = "log.csv"
CURVE = "curve.png"
SAMPLES = "samples.png"
PAGE = "training.html"
EVENTS = "events"  # Folder of event files for TensorBoard
EVENT_FILE = "events.out.tfevents"  # Its name without the number of the epoch
RECIPE = "recipe.toml"
CLASS_COUNTS = "class_counts.json"
FOLDS = "folds"
STREETS = "streets"
RESULTS = (CHECKPOINT, BEST, LAST, LOG, CURVE, SAMPLES, PAGE)  # A new training removes them

Row = dict[str, float]
"""One epoch: epoch, learning_rate, loss, seconds; if validated, also what `validate` returns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FurtherData:
    """Further data set of a training."""

    label_space: LabelSpace
    scans: str  # Their `scans_digest`


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Settings that determine the result of a training."""

    recipe: Recipe
    sensor: Sensor
    label_space: LabelSpace
    scans: str  # `scans_digest` of the training and validation scans
    weights: str | None = None  # SHA-256 of the initial weights
    labels: str | None = None  # Digest of the labels of a cross-validated training
    also: tuple[FurtherData, ...] | None = None
    held_out: str | None = None  # `scans_digest` of the scans of a fold
    samples: str = WORKERS  # Where samples are made; also in records of older versions

    @property
    def decisive(self) -> dict[str, object]:
        """Settings that may not change when a training is resumed; the parts of a batch may."""
        recipe = replace(self.recipe, accumulate=Recipe().accumulate)
        return settings_json(replace(self, recipe=recipe))


def training_settings(
    recipe: Recipe, sources: Sequence[Source], weights: Path | None, samples: str
) -> TrainingSettings:
    """Return the settings of a training.

    Parameters
    ----------
    recipe : Recipe
        Recipe of the training.
    sources : sequence of Source
        Training scans, validation scans, further data sets.
    weights : Path, optional
        Initial weights; None for random ones.
    samples : str
        Where samples are made.

    Returns
    -------
    TrainingSettings
    """
    first, validation, *further = sources
    labels = None
    if first.files and recipe.folds:
        # The labels of a few scans are often corrected between two trainings.
        digests = "".join(fingerprint(labels_source(file)) for file in first.files)
        labels = hashlib.sha256(digests.encode()).hexdigest()[:16]
    further_data = [
        FurtherData(label_space=source.space, scans=scans_digest(source.files))
        for source in further
    ]
    return TrainingSettings(
        recipe=recipe,
        sensor=replace(first.sensor, intensity_quantiles=(), row_gaps=None),
        label_space=first.space,
        scans=scans_digest([*first.files, *validation.files]),
        weights=fingerprint(weights) if weights else None,
        labels=labels,
        also=tuple(further_data) or None,
        samples=samples,
    )


def scans_digest(scans: Sequence[ScanFile]) -> str:
    """Return the number of scans and a digest of their names."""
    names = "\n".join(scan.name for scan in scans)
    return f"{len(scans)}, {hashlib.sha256(names.encode()).hexdigest()[:16]}"


def fold_folder(run: Path, number: int) -> Path:
    """Return the run folder of a fold of a cross-validation, counted from 1."""
    return run / FOLDS / str(number)


def tensorboard_file(run: Path, epoch: int) -> Path:
    """Return the event file of an epoch, counted from 1; TensorBoard finds it by its name."""
    return run / EVENTS / f"{EVENT_FILE}.{epoch:06d}"


def resumption(run: Path) -> str:
    """State, in words, from where the training in a folder would resume."""
    if any((folder / CHECKPOINT).exists() for folder in _folders(run)):
        return "the same command resumes from the last checkpoint"
    return "no checkpoint is written yet, so the same command starts again"


def recorded_settings(run: Path) -> TrainingSettings | None:
    """Return the settings of the training in a folder, None without one."""
    manifest = Manifest(run)
    if (record := manifest.record(STAGE)) is None:
        return None
    try:
        return record_of(TrainingSettings, record.settings, manifest.path(STAGE))
    except OutputError as error:
        weights = setting("weights", run / LAST)
        hint = f"use another folder, and {weights} to start from the weights of this"
        raise OutputError(error.subject, error.problem, error.expected, hint) from error


def recorded_precision(run: Path) -> str | None:
    """Return the number type of the training in a folder, None if it is not recorded."""
    settings = recorded_settings(run)
    precision = settings.recipe.precision if settings else None
    return None if precision == "auto" else precision


def recorded_samples(run: Path) -> str | None:
    """Return where the samples of the training in a folder are made, None without one."""
    settings = recorded_settings(run)
    return settings.samples if settings else None


def require_free(run: Path, settings: TrainingSettings, *, overwrite: bool) -> None:
    """Refuse a folder that cannot be written, and what `require_replaceable` refuses."""
    require_writable(run)
    require_replaceable(run, settings, overwrite=overwrite)


def require_replaceable(run: Path, settings: TrainingSettings, *, overwrite: bool) -> None:
    """Refuse a folder with files that a training may not replace, or with other settings."""
    owned = OwnedFolder(run, STAGE)
    recorded = None if overwrite else recorded_settings(run)
    owned.refuse_foreign([*_results(run), run / CLASS_COUNTS, run / RECIPE])
    has_results = any((folder / name).exists() for folder in _folders(run) for name in RESULTS)
    if recorded and has_results:
        before = _extended(recorded, settings).decisive
        require_same_settings(owned.record_path, before, settings.decisive)


def record_start(run: Path, settings: TrainingSettings, *, overwrite: bool) -> None:
    """Record a training in a free folder; remove results of other settings, or all to overwrite."""
    owned = OwnedFolder(run, STAGE)
    recorded = None if overwrite else recorded_settings(run)
    if not recorded or _extended(recorded, settings).decisive != settings.decisive:
        for folder in _folders(run):
            OwnedFolder(folder).remove_written(_results(folder))
    owned.manifest.write(StageRecord(stage=STAGE, settings=settings_json(settings)))
    owned.write(run / RECIPE, settings.recipe.to_toml().encode())


def _folders(run: Path) -> list[Path]:
    """Return the run folder and the folders of its folds."""
    return [run, *run.glob(f"{FOLDS}/*")]


def _results(folder: Path) -> list[Path]:
    """Return the results of a training in a folder, which a new training removes."""
    event_files = (folder / EVENTS).glob(f"{EVENT_FILE}.{6 * '[0-9]'}")
    return [*(folder / name for name in RESULTS), *event_files]


def _extended(recorded: TrainingSettings, requested: TrainingSettings) -> TrainingSettings:
    """Return recorded settings, with more epochs if those before stay the same."""
    recipe = requested.recipe
    steady = recipe.schedule == "decay" and not recipe.folds
    if steady and recorded.recipe.epochs < recipe.epochs:
        return replace(recorded, recipe=replace(recorded.recipe, epochs=recipe.epochs))
    return recorded


def write_log(path: Path, rows: Sequence[Row]) -> None:
    """Write one line per epoch as CSV; cells without a measurement are empty."""
    text = io.StringIO()
    columns = dict.fromkeys(key for row in rows for key in row)
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    for row in rows:
        # NaN is no measurement.
        table.writerow({k: f"{value:.6g}" for k, value in row.items() if value == value})
    OwnedFolder(path.parent).write(path, text.getvalue().encode())
