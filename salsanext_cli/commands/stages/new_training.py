# SPDX-License-Identifier: MIT
"""Training that is about to begin: what it needs, and what it would do."""

import logging
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from salsanext_cli.commands.jobs.epoch_files import EpochFiles
from salsanext_cli.commands.jobs.plans.training_plan import TrainingPlan
from salsanext_cli.commands.stages.training_scenes import scan_counts_of_scenes, simulated_scenes
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.atomic import foresee_writable
from salsanext_cli.io.weights.card_file import default_weights, named_weights, read_card
from salsanext_cli.runs.annotation.label_records import require_labels
from salsanext_cli.runs.annotation.las_classification import labels_source
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.training.data.batch_source import DEVICE, WORKERS
from salsanext_cli.training.data.class_counts import class_counts
from salsanext_cli.training.data.dataset import SamplingPlan
from salsanext_cli.training.data.on_device.device_room import DeviceRoom
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.data.sources import (
    ScansToTrainOn,
    Source,
    further_source,
    scans_to_train_on,
    training_sources,
)
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.fit import StepReport
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import common_precision
from salsanext_cli.training.preconditions import require_memory
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import (
    CHECKPOINT,
    CLASS_COUNTS,
    PAGE,
    STAGE,
    STREETS,
    TrainingSettings,
    record_start,
    recorded_precision,
    recorded_samples,
    require_free,
    require_replaceable,
    training_settings,
)
from salsanext_cli.training.setup import Setup, TrainingData, scan_store
from salsanext_cli.training.step_memory import StepMemory

AUTO = "auto"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CheckedTraining:
    """Training whose settings are checked, but neither its folder nor its labels.

    Attributes
    ----------
    recipe : Recipe
        Recipe with a number type.
    initial : SegmentationNetwork
        Network before training.
    card : WeightsCard
        Its description.
    sources : list of Source
        Training scans, validation scans, and scans of further data sets.
    room : DeviceRoom
        Room on the device for scans.
    samples : str
        Where samples are made.
    settings : TrainingSettings
        Settings to record.
    """

    recipe: Recipe
    initial: SegmentationNetwork
    card: WeightsCard
    sources: list[Source]
    room: DeviceRoom
    samples: str
    settings: TrainingSettings

    @property
    def scene_counts(self) -> list[int]:
        """Number of scans of each data set of simulated scenes."""
        return scan_counts_of_scenes(self.recipe.streets, self.sources[0].space)

    @property
    def sampling(self) -> SamplingPlan:
        """Order of the samples."""
        first, _, *further = self.sources
        counts = [len(source.files) for source in [first, *further]]
        return SamplingPlan(scan_counts=[*counts, *self.scene_counts], recipe=self.recipe)


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
        checked = self._checked(space, sensor)
        self._announce(checked)
        settings = checked.settings
        data = self.group.on_main(partial(self._prepare, locks, checked.sources, settings))
        return Setup(
            run=self.run,
            recipe=checked.recipe,
            settings=settings,
            overwrite=self.overwrite,
            initial=checked.initial,
            card=self._described(checked.card, data),
            error=read_card(start).error if start else None,
            data=data,
            device=self.device,
            group=self.group,
            workers=self.jobs if self.jobs > 1 else 0,
            store=self._store(checked, data),
            report=report,
            watch=EpochFiles(tensorboard=self.tensorboard),
        )

    def plan(self, space: LabelSpace | None, sensor: Sensor | None) -> TrainingPlan:
        """Return what a training would do, and write nothing; arguments as of `setup`."""
        checked = self._checked(space, sensor)
        foresee_writable(self.run)
        require_replaceable(self.run, checked.settings, overwrite=self.overwrite)
        _require_labels(checked.sources)
        return TrainingPlan.from_sources(
            self.run,
            checked.sources,
            checked.sampling,
            checked.initial,
            checked.card,
            scenes=sum(checked.scene_counts),
            overwrite=self.overwrite,
        )

    def _checked(self, space: LabelSpace | None, sensor: Sensor | None) -> CheckedTraining:
        """Check all but the folder and the labels; arguments as of `setup`."""
        start = self.start
        scans = self.group.on_main(
            lambda: scans_to_train_on(self.roots[0], space, divisible=self.recipe.folds > 0)
        )
        recipe = self._resolved_recipe()
        initial, card = initial_network(start, scans.space, recipe, sensor)
        sources = self._sources(scans, card.sensor)
        step = self._step_memory(recipe, card.sensor)
        room = DeviceRoom(
            device=self.device, step=step, workers=self.group.size, workers_here=workers_here()
        )
        samples = self.group.on_main(partial(self._kind_of_samples, sources, room))
        require_memory(step, self.group, self.device)
        return CheckedTraining(
            recipe=recipe,
            initial=initial,
            card=card,
            sources=sources,
            room=room,
            samples=samples,
            settings=training_settings(recipe, sources, start, samples),
        )

    def _store(self, checked: CheckedTraining, data: TrainingData) -> ScanStore | None:
        """Return the store of the scans for samples that are made on the device."""
        if checked.samples != DEVICE:
            return None
        return scan_store(checked.recipe, data, checked.room, self.readers)

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
        sharing = workers_here() if is_shared else 1
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

    def _announce(self, checked: CheckedTraining) -> None:
        """Log the device, the numbers of scans, and the images and steps of an epoch."""
        if not self.group.is_main:
            return
        if checked.samples == DEVICE:
            log.log(NOTICE, "device: %s, which also makes the samples", self.device)
        else:
            text = "device: %s; processes that prepare samples: %d"
            log.log(NOTICE, text, self.device, self.jobs)
        recipe = checked.recipe
        seen = checked.card.sensor
        training, validation, *_ = checked.sources
        steps = checked.sampling.steps_per_epoch
        columns = recipe.crop_width or seen.width
        scans = counted(len(training.files), "scan")
        numbers = f"{scans} for training, {len(validation.files):,} for validation"
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
        _require_labels(sources)
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


def _require_labels(sources: Sequence[Source]) -> None:
    """Refuse scans without labels."""
    files = [file for source in sources for file in source.files]
    # The others have their labels inside.
    require_labels([file for file in files if labels_source(file) != file.path])


def workers_here() -> int:
    """Return the number of workers of torchrun on this machine.

    Returns
    -------
    int
    """
    return int(os.environ.get("LOCAL_WORLD_SIZE", 1))
