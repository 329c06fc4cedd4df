# SPDX-License-Identifier: MIT
"""Stage `train`: a labelled data set to a run folder with weights and log."""

import logging
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from salsanext_cli.commands.jobs.epoch_files import EpochFiles
from salsanext_cli.commands.jobs.event_files import require_tensorboard
from salsanext_cli.commands.stages.training_scenes import simulated_scenes
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import setting
from salsanext_cli.io.weights.card_file import default_weights, named_weights, read_card
from salsanext_cli.runs.labelling.label_records import require_labels
from salsanext_cli.runs.labelling.las_classification import labels_source
from salsanext_cli.runs.loop.run_options import cores, worker_count
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.selection import evenly_spaced
from salsanext_cli.runs.summary.scan_warnings import ScanWarning
from salsanext_cli.training.cross_validated_training import CrossValidatedTraining
from salsanext_cli.training.cross_validation import Expectation
from salsanext_cli.training.data.batch_source import DEVICE, WORKERS
from salsanext_cli.training.data.class_counts import class_counts
from salsanext_cli.training.data.dataset import SamplingPlan
from salsanext_cli.training.data.on_device.device_room import DeviceRoom
from salsanext_cli.training.data.sources import (
    ScansToTrainOn,
    Source,
    further_source,
    scans_to_train_on,
    training_sources,
)
from salsanext_cli.training.distributed import ProcessGroup, group_of_environment, process_group
from salsanext_cli.training.fit import StepReport
from salsanext_cli.training.initial_network import inheriting, initial_network
from salsanext_cli.training.int8_ranges import add_int8_ranges
from salsanext_cli.training.learner import common_precision
from salsanext_cli.training.preconditions import require_batch, require_memory
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import (
    BEST,
    CHECKPOINT,
    CLASS_COUNTS,
    LAST,
    PAGE,
    STAGE,
    STREETS,
    Row,
    TrainingSettings,
    record_start,
    recorded_precision,
    recorded_samples,
    require_free,
    training_settings,
)
from salsanext_cli.training.setup import Setup, TrainingData, scan_store
from salsanext_cli.training.step_memory import StepMemory

MAX_LOADERS = 8  # Largest default number of processes that prepare samples for a GPU
AUTO = "auto"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainResult:
    """Result of a training."""

    best: Path  # Weights of the best validation
    last: Path  # Weights of the last epoch
    best_miou: float | None  # On points, after kNN; None without a validation split
    rows: Sequence[Row]  # The log, a row per epoch
    warnings: list[ScanWarning]  # Reasons to doubt scans
    expected: Expectation | None = None  # Estimate for new scans, after a cross-validation

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON; the log is a file of its own."""
        data: dict[str, object] = {"stage": "train", "best_miou": self.best_miou}
        if self.expected is not None:
            data["expected"] = plain(self.expected)
        data["best"] = str(self.best)
        data["last"] = str(self.last)
        data["warnings"] = plain(self.warnings)
        return data


@dataclass(frozen=True, slots=True, kw_only=True)
class NewTraining:
    """Training that is about to begin in its run folder."""

    roots: tuple[Path, ...]  # Data set, and further data sets
    run: Path
    recipe: Recipe
    weights: Path | None
    overwrite: bool
    samples: str  # Where samples are made: auto, device or workers
    jobs: int  # Processes that prepare samples
    readers: int  # Threads that read scans into memory
    group: ProcessGroup
    device: torch.device
    tensorboard: bool  # Whether to write event files too

    @property
    def start(self) -> Path | None:
        """Initial weights, None for random ones."""
        is_default = self.weights is None and self.recipe.initial == "default"
        return default_weights() if is_default else self.weights

    def setup(
        self,
        locks: ExitStack,
        space: LabelSpace | None,
        sensor: Sensor | None,
        report: Callable[[StepReport], object],
    ) -> Setup:
        """Check everything that a training needs, and return it.

        Parameters
        ----------
        locks : ExitStack
            Holds the lock of the run folder.
        space : LabelSpace, optional
            Classes, as `train` takes them.
        sensor : Sensor, optional
            Sensor of the images, as `train` takes it.
        report : callable
            Called after every step.

        Returns
        -------
        Setup
        """
        start = self.start
        scans = self.group.on_main(
            lambda: scans_to_train_on(self.roots[0], space, divisible=self.recipe.folds > 0)
        )
        recipe = self._resolved_recipe()
        initial, card = initial_network(start, scans.space, recipe, sensor)
        sources = self._sources(scans, card.sensor)
        step = self._step_memory(recipe, card.sensor)
        room = DeviceRoom(
            device=self.device, step=step, workers=self.group.size, workers_here=_workers_here()
        )
        kind = self.group.on_main(partial(self._kind_of_samples, sources, room))
        self._announce(recipe, card.sensor, scans, kind)
        require_memory(step, self.group, self.device)
        settings = training_settings(recipe, sources, start, kind)
        data = self.group.on_main(partial(self._prepare, locks, sources, settings))
        return Setup(
            run=self.run,
            recipe=recipe,
            settings=settings,
            overwrite=self.overwrite,
            initial=initial,
            card=self._described(card, data),
            error=read_card(start).error if start else None,
            data=data,
            device=self.device,
            group=self.group,
            workers=self.jobs if self.jobs > 1 else 0,
            store=scan_store(recipe, data, room, self.readers) if kind == DEVICE else None,
            report=report,
            watch=EpochFiles(tensorboard=self.tensorboard),
        )

    def _resolved_recipe(self) -> Recipe:
        """Return the recipe with a number type: that of an earlier part, else of the device."""
        if self.recipe.precision != "auto":
            return self.recipe
        recorded = None
        if not self.overwrite:
            recorded = self.group.on_main(partial(recorded_precision, self.run))
        precision = recorded or common_precision(self.device, self.group)
        return replace(self.recipe, precision=precision)

    def _step_memory(self, recipe: Recipe, seen: Sensor) -> StepMemory | None:
        """Return the images that a worker computes at once; None for an unknown network."""
        is_shared = self.device.type == "cpu"
        sharing = _workers_here() if is_shared else 1
        return StepMemory.from_recipe(recipe, seen, self.device.type, self.group.size, sharing)

    def _kind_of_samples(self, sources: Sequence[Source], room: DeviceRoom) -> str:
        """Return where samples are made: as requested, else as before, else as the device is."""
        if self.samples != AUTO:
            return self.samples
        recorded = None if self.overwrite else recorded_samples(self.run)
        if recorded or self.device.type != "cuda":
            return recorded or WORKERS
        first, _, *further = sources
        return DEVICE if room.has_room_for([first, *further]) else WORKERS

    def _announce(self, recipe: Recipe, seen: Sensor, scans: ScansToTrainOn, samples: str) -> None:
        """Log the device, the numbers of scans, and the images and steps of an epoch."""
        if not self.group.is_main:
            return
        if samples == DEVICE:
            log.log(NOTICE, "device: %s, which also makes the samples", self.device)
        else:
            text = "device: %s; processes that prepare samples: %d"
            log.log(NOTICE, text, self.device, self.jobs)
        steps = SamplingPlan(scan_counts=[len(scans.training)], recipe=recipe).steps_per_epoch
        columns = recipe.crop_width or seen.width
        training = counted(len(scans.training), "scan")
        numbers = f"{training} for training, {len(scans.validation):,} for validation"
        images = f"{steps * recipe.batch:,} images of {seen.height}×{columns}"
        log.log(NOTICE, "%s; an epoch has %s in %s", numbers, images, counted(steps, "step"))

    def _sources(self, scans: ScansToTrainOn, seen: Sensor) -> list[Source]:
        """Return the training scans, the validation scans and the scans of further data sets."""
        further = self.group.on_main(
            lambda: [further_source(root, scans.space, seen) for root in self.roots[1:]]
        )
        return [
            Source(files=scans.training, space=scans.space, sensor=seen),
            Source(files=scans.validation, space=scans.space, sensor=seen),
            *further,
        ]

    def _prepare(
        self, locks: ExitStack, sources: Sequence[Source], settings: TrainingSettings
    ) -> TrainingData:
        """Lock and check the folder, check the scans, and record the settings."""
        run = self.run
        recipe = self.recipe
        locks.enter_context(OwnedFolder(run, STAGE).open())
        require_free(run, settings, overwrite=self.overwrite)
        files = [file for source in sources for file in source.files]
        # The others have their labels inside.
        require_labels([file for file in files if labels_source(file) != file.path])
        scenes = simulated_scenes(run / STREETS, recipe.streets, sources[0], self.jobs)
        fit = recipe.sensors == "fitted"
        training, validation, *further = training_sources(
            [*sources, *scenes], fit=fit, jobs=self.jobs
        )
        to_validate = evenly_spaced(validation.files, recipe.validation_scans)
        counts = class_counts(
            run / CLASS_COUNTS,
            [training, *further],
            validation,
            to_validate,
            self.jobs,
            recipe.also,
        )
        record_start(run, settings, overwrite=self.overwrite)
        if not (run / CHECKPOINT).exists():
            random = f"random weights ({setting('weights', 'default')}: those of the package)"
            begun = self.start.name if self.start else random
            log.log(NOTICE, "training from %s; the first step begins", begun)
            log.log(NOTICE, "curve and sample predictions after each epoch: %s", run / PAGE)
        return TrainingData(
            validation=replace(validation, files=to_validate),
            sources=[training, *further],
            counts=counts,
        )

    def _described(self, card: WeightsCard, data: TrainingData) -> WeightsCard:
        """Return the card of the new weights: their sensor, origin and description."""
        names = ", ".join(path.resolve().name for path in self.roots)
        is_simulated = any(source.simulated for source in data.sources)
        simulated = ", simulated scenes" if is_simulated else ""
        recipe = {}
        if self.weights:
            recipe = {"initial": named_weights(read_card(self.weights), self.weights)}
        return replace(
            card,
            sensor=data.sources[0].sensor,
            recipe=recipe,
            description=f"Trained with `salsanext train` on {names}{simulated}.",
        )


def train(
    dataset: Path,
    run: Path,
    *,
    recipe: Recipe,
    sensor: Sensor | None = None,
    space: LabelSpace | None = None,
    device: str = "auto",
    samples: str = AUTO,
    jobs: int | None = None,
    weights: Path | None = None,
    overwrite: bool = False,
    also: Sequence[Path] = (),
    tensorboard: bool = False,
    progress: Callable[[StepReport], object] = lambda report: None,
) -> TrainResult:
    """Train a network, or resume an interrupted training in the same folder.

    A recipe with folds cross-validates scans without a validation split, then trains on all of
    them. Workers of torchrun share every batch.

    Parameters
    ----------
    dataset : Path
        Labelled data set.
    run : Path
        Folder for weights, log and checkpoint.
    recipe : Recipe
        Settings of the training.
    sensor : Sensor, optional
        Sensor of the images; by default that of the initial weights, else an HDL-64.
    space : LabelSpace, optional
        Classes; by default those of the data set.
    device : str
        Device, such as ``"cpu"`` or ``"cuda:0"``; by default a GPU if there is one.
    samples : str
        Where samples are made: ``"device"``, from scans in its memory, or ``"workers"``, processes
        that read scans for each batch. By default as before in this folder, else on a GPU.
    jobs : int, optional
        Number of processes that prepare samples, or of threads that read scans for the device; by
        default up to eight processes on a GPU, else one, and one thread per core.
    weights : Path, optional
        Initial weights, by default those of the recipe.
    overwrite : bool
        Whether to start again instead of resuming.
    also : sequence of Path
        Further data sets for a share of the samples.
    tensorboard : bool
        Whether to write event files for TensorBoard too, which must be installed.
    progress : callable
        Called with a `StepReport` after every step.

    Returns
    -------
    TrainResult
    """
    require_batch(recipe.batch, group_of_environment())
    if tensorboard:
        require_tensorboard()
    with process_group(device) as (group, chosen), ExitStack() as locks:
        new = NewTraining(
            roots=(dataset, *also),
            run=run,
            recipe=recipe,
            weights=weights,
            overwrite=overwrite,
            samples=samples,
            jobs=_workers(jobs, chosen.type),
            readers=max(1, cores() // _workers_here()) if jobs is None else worker_count(jobs),
            group=group,
            device=chosen,
            tensorboard=tensorboard,
        )
        return _trained(new.setup(locks, space, sensor, progress), new.start)


def _trained(setup: Setup, start: Path | None) -> TrainResult:
    """Cross-validate scans without a validation split, and train on all scans.

    `start`: initial weights, whose error model the new ones inherit unless they get their own.
    """
    run = setup.run
    data = setup.data
    has_validation = bool(data.validation.files)
    expected = None
    if not has_validation:
        cross_validated = CrossValidatedTraining(setup)
        expected = cross_validated.expectation()
        setup = cross_validated.setup_of_all_scans(expected)
    if start and not expected:
        setup = replace(setup, card=inheriting(setup.card, start))
    state = setup.training(data.sources[0].files, data.validation).fit()
    setup.group.on_main(partial(add_int8_ranges, run, data.sources[0], str(setup.device)))
    return TrainResult(
        best=run / BEST,
        last=run / LAST,
        best_miou=state.best if has_validation else None,
        rows=state.rows,
        warnings=data.counts.warnings,
        expected=expected,
    )


def _workers_here() -> int:
    """Return the number of workers of torchrun on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", 1))


def _workers(jobs: int | None, kind: str) -> int:
    """Return the number of processes that prepare samples; by default one on a CPU."""
    default = 1 if kind == "cpu" else max(1, min(MAX_LOADERS, cores() // _workers_here()))
    return default if jobs is None else worker_count(jobs)
