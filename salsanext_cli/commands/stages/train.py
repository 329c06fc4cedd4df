# SPDX-License-Identifier: MIT
"""Stage `train`: a labelled data set to a run folder with weights and log."""

import logging
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from salsanext_cli.commands.stages.synth import SynthSettings, synthesise
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import setting
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import default_weights, named_weights, read_card
from salsanext_cli.io.weights.loading import network_of_module
from salsanext_cli.io.weights.weights import encode_weights, read_weights
from salsanext_cli.runs.fit.scan_reading import read_prepared
from salsanext_cli.runs.labelling.label_records import require_labels
from salsanext_cli.runs.loop.run_options import cores, worker_count
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.selection import evenly_spaced
from salsanext_cli.runs.summary.scan_warnings import ScanWarning
from salsanext_cli.synthesis.lidar import RIGS
from salsanext_cli.training.cross_validation import Expectation
from salsanext_cli.training.data.class_counts import ClassCounts, class_counts
from salsanext_cli.training.data.dataset import SamplingPlan
from salsanext_cli.training.data.sources import (
    Source,
    further_source,
    merged_into,
    scans_to_train_on,
    training_sources,
)
from salsanext_cli.training.distributed import ProcessGroup, group_of_environment, process_group
from salsanext_cli.training.fit import StepReport
from salsanext_cli.training.learner import common_precision
from salsanext_cli.training.memory import memory_of
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import (
    BEST,
    CHECKPOINT,
    CLASS_COUNTS,
    LAST,
    STAGE,
    STREETS,
    Row,
    TrainingSettings,
    record_start,
    recorded_precision,
    require_free,
    training_settings,
)
from salsanext_cli.training.setup import Setup, inheriting, initial_network
from salsanext_cli.training.step_memory import StepMemory
from salsanext_cli.training.tuning.int8 import int8_inputs

MAX_LOADERS = 8  # Largest default number of processes that prepare samples for a GPU
INT8_SCANS = 8  # Training scans that the ranges for int8 are fitted to
SCANS_OF_STREET, STREET_SPACING_M = 8, 10.0  # Of a simulated scene

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TrainResult:
    """Result of a training."""

    best: Path  # Weights of the best validation
    last: Path  # Weights of the last epoch
    best_miou: float | None  # On points, after kNN; None without a validation split
    rows: Sequence[Row]  # The log, a row per epoch
    warnings: list[ScanWarning]  # Reasons to doubt scans
    expected: Expectation | None = None  # Estimate for new scans, after a cross-validation


@dataclass(frozen=True, slots=True)
class NewTraining:
    """Training that is about to begin in its run folder; `roots` are its data sets."""

    roots: tuple[Path, ...]
    run: Path
    recipe: Recipe
    weights: Path | None
    jobs: int
    overwrite: bool

    @property
    def start(self) -> Path | None:
        """Initial weights, None for random ones."""
        is_default = self.weights is None and self.recipe.initial == "default"
        return default_weights() if is_default else self.weights

    def prepare(
        self, locks: ExitStack, given: Sequence[Source], settings: TrainingSettings
    ) -> tuple[list[Source], ClassCounts]:
        """Lock and check the folder, check the scans, and record the settings.

        Return validation, training and further scans, with fitted sensors, and the class counts.
        """
        run, recipe, first = self.run, self.recipe, given[0]
        locks.enter_context(OwnedFolder(run, STAGE).open())
        require_free(run, settings, overwrite=self.overwrite)
        require_labels([file for source in given for file in source.files])
        scenes = _simulated_scenes(run / STREETS, recipe.streets, first, self.jobs)
        is_fitted = recipe.sensors == "fitted"
        first, scored, *others = training_sources([*given, *scenes], fit=is_fitted, jobs=self.jobs)
        sources, validated = [first, *others], evenly_spaced(scored.files, recipe.validation_scans)
        path = run / CLASS_COUNTS
        counts = class_counts(path, sources, scored, validated, self.jobs, recipe.also)
        record_start(run, settings, overwrite=self.overwrite)
        random = f"random weights ({setting('weights', 'default')}: those of the package)"
        if not (run / CHECKPOINT).exists():
            begun = self.start.name if self.start else random
            log.log(NOTICE, "training from %s; the first step begins", begun)
        return [replace(scored, files=validated), *sources], counts

    def setup(
        self,
        locks: ExitStack,
        space: LabelSpace | None,
        sensor: Sensor | None,
        group: ProcessGroup,
        device: torch.device,
        report: Callable[[StepReport], object],
    ) -> tuple[Setup, Source]:
        """Return the setup of the training, and the scans for validation."""
        recipe, start, divisible = self.recipe, self.start, self.recipe.folds > 0
        dataset, *also = self.roots
        classes, training, validation = group.on_main(
            lambda: scans_to_train_on(dataset, space, divisible=divisible)
        )
        if recipe.precision == "auto":
            known = None if self.overwrite else group.on_main(partial(recorded_precision, self.run))
            recipe = replace(recipe, precision=known or common_precision(device, group))
        initial, card = initial_network(start, classes, recipe, sensor)
        if group.is_main:
            log.log(NOTICE, "device: %s; processes that prepare samples: %d", device, self.jobs)
            _announce_images(recipe, card.sensor, len(training), len(validation))
        _require_memory(recipe, card.sensor, group, device)
        further = group.on_main(lambda: [further_source(p, classes, card.sensor) for p in also])
        given = [Source(files, classes, card.sensor) for files in (training, validation)] + further
        settings = training_settings(recipe, given, start)
        (scored, *sources), counts = group.on_main(partial(self.prepare, locks, given, settings))
        simulated = ", simulated scenes" if any(source.simulated for source in sources) else ""
        names = ", ".join(path.resolve().name for path in self.roots)
        card = replace(
            card,
            sensor=sources[0].sensor,
            recipe={"initial": named_weights(read_card(start), start)}
            if start and self.weights
            else {},
            description=f"Trained with `salsanext train` on {names}{simulated}.",
        )
        setup = Setup(
            run=self.run,
            recipe=recipe,
            initial=initial,
            card=card,
            sources=sources,
            counts=counts,
            settings=settings,
            device=device,
            group=group,
            workers=self.jobs if self.jobs > 1 else 0,
            overwrite=self.overwrite,
            error=read_card(start).error if start else None,
            report=report,
        )
        return setup, scored


def train(
    dataset: Path,
    run: Path,
    *,
    recipe: Recipe,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    device: str = "auto",
    jobs: int | None = None,
    weights: Path | None = None,
    overwrite: bool = False,
    also: Sequence[Path] = (),
    progress: Callable[[StepReport], object] = lambda report: None,
) -> TrainResult:
    """Train a network, or resume an interrupted training in the same folder.

    A recipe with folds cross-validates scans without a validation split, then trains on all of
    them. Workers of torchrun share every batch.

    Parameters
    ----------
    dataset, run : Path
        Labelled data set, and folder for weights, log and checkpoint.
    recipe : Recipe
    sensor, space : Sensor, LabelSpace, optional
        By default those of the initial weights, else an HDL-64, and those of the data set.
    device, jobs : str, int, optional
        Number of processes that prepare samples: by default up to eight on a GPU, else one.
    weights : Path, optional
        Initial weights, by default those of the recipe.
    overwrite : bool
        Whether to start again instead of resuming.
    also : sequence of Path
        Further data sets for a share of the samples.
    progress : callable
        Called with a `StepReport` after every step.

    Returns
    -------
    TrainResult
    """
    _require_batch(recipe.batch, group_of_environment())
    with process_group(device) as (group, chosen), ExitStack() as locks:
        roots, workers = (dataset, *also), _workers(jobs, chosen.type)
        new = NewTraining(roots, run, recipe, weights, workers, overwrite)
        setup, scored = new.setup(locks, space, sensor, group, chosen, progress)
        expected = None if scored.files else setup.cross_validated()
        if not scored.files:
            setup = setup.after(expected)
        if new.start and not expected:
            setup = replace(setup, card=inheriting(setup.card, new.start))
        state = setup.training(setup.sources[0].files, scored).fit()
        group.on_main(partial(_add_int8, run, setup.sources[0], str(chosen)))
    best = state.best if scored.files else None
    return TrainResult(run / BEST, run / LAST, best, state.rows, setup.counts.warnings, expected)


def _add_int8(run: Path, source: Source, device: str) -> None:
    """Add ranges for int8 to the weights of a finished training, unless they are there."""
    for path in filter(Path.exists, (run / BEST, run / LAST)):
        module, card = read_weights(path)
        if card.int8:
            continue
        network = network_of_module(module.to(device), card, device)
        inputs = [
            read_prepared(file, network.for_sensor(source.sensor_of(file))).scan.input
            for file in evenly_spaced(source.files, INT8_SCANS)
        ]
        card = replace(card, int8=int8_inputs(module, inputs))
        OwnedFolder(run).write(path, encode_weights(module, card), durable=True)


def _workers(jobs: int | None, kind: str) -> int:
    """Return the number of processes that prepare samples; by default one on a CPU."""
    workers_here = int(os.environ.get("LOCAL_WORLD_SIZE", 1))
    usual = 1 if kind == "cpu" else max(1, min(MAX_LOADERS, cores() // workers_here))
    return usual if jobs is None else worker_count(jobs)


def _announce_images(recipe: Recipe, seen: Sensor, training: int, validation: int) -> None:
    """Log the numbers of scans, and the images and steps of an epoch."""
    steps = SamplingPlan([training], recipe).steps_per_epoch
    columns = recipe.crop_width or seen.width
    scans = f"{counted(training, 'scan')} for training, {validation:,} for validation"
    images = (
        f"{steps * recipe.batch:,} images of {seen.height}×{columns} in {counted(steps, 'step')}"
    )
    log.log(NOTICE, "%s; an epoch has %s", scans, images)


def _require_memory(
    recipe: Recipe, seen: Sensor, group: ProcessGroup, device: torch.device
) -> None:
    """Refuse or warn of a step that needs more memory than the device has."""
    sharing = int(os.environ.get("LOCAL_WORLD_SIZE", 1)) if device.type == "cpu" else 1
    step = StepMemory.of(recipe, seen, device.type, group.size, sharing)
    memory = memory_of(str(device))
    if step and memory:
        group.on_main(partial(step.require_fits, memory))


def _require_batch(samples: int, group: ProcessGroup) -> None:
    if samples < group.size:
        expected = f"at least one sample for each of {group.size} workers"
        hint = "start fewer workers or set batch higher"
        error = UsageError("recipe key batch", f"is {samples}", expected, hint)
        error.reported_elsewhere = not group.is_main
        raise error


def _simulated_scenes(folder: Path, count: int, real: Source, jobs: int) -> list[Source]:
    """Return simulated data sets by kind of sensor, made if need be; none for other classes."""
    if not count:
        return []
    if merged_into(label_space(), real.space) is None:
        log.log(NOTICE, "no simulated scenes: their classes cannot be merged into your classes")
        return []
    splits, sources = {"train": count, "valid": 0, "test": 0}, []
    scenes: dict[str, Any] = {"scans": SCANS_OF_STREET, "seed": 0, "spacing": STREET_SPACING_M}
    for kind in RIGS:
        root = folder / kind
        wanted = SynthSettings.of(splits, **scenes, sensor=kind).record
        if (recorded := Manifest(root).record(wanted.stage)) != wanted:
            reason = ": the existing ones have another version or settings" if recorded else ""
            log.log(NOTICE, "simulating %s in %s%s", counted(count, "scene"), root, reason)
        is_other = recorded not in (None, wanted)
        synthesise(root, train=count, valid=0, **scenes, sensor=kind, jobs=jobs, overwrite=is_other)
        sources.append(replace(further_source(root, real.space, real.sensor), simulated=True))
    return sources
