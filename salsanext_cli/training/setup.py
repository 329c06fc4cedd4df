# SPDX-License-Identifier: MIT
"""Setup of a training: everything that it needs, except the choice of its scans."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data.batch_source import BatchSource, WorkerBatches
from salsanext_cli.training.data.class_counts import ClassCounts, class_weights, rare_classes
from salsanext_cli.training.data.dataset import Samples
from salsanext_cli.training.data.on_device.device_batches import DeviceBatches
from salsanext_cli.training.data.on_device.device_room import DeviceRoom
from salsanext_cli.training.data.on_device.scan_memory import ScanMemory
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.data.targets import class_sets, target_mask
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.fit import EpochWatch, FinishedEpoch, StepReport, Training
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import TrainingSettings


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrainingData:
    """Checked scans of a training, with fitted sensors."""

    validation: Source  # Without files for a training without validation
    sources: Sequence[Source]  # Training scans of the data set, and further data sets
    counts: ClassCounts


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Setup:
    """Everything that a training needs, except the choice of its scans."""

    run: Path
    recipe: Recipe
    settings: TrainingSettings
    overwrite: bool
    initial: SegmentationNetwork  # The network before training
    # Of the weights files; recipe: the keys that differ; trained_on: scans of the initial weights
    card: WeightsCard
    error: ErrorModel | None  # Error model of the initial weights
    data: TrainingData
    device: torch.device
    group: ProcessGroup
    workers: int  # Processes that prepare samples; 0 for none
    store: ScanStore | None  # Scans in memory for samples made on the device; None for workers
    report: Callable[[StepReport], object]  # Called after every step
    watch: Callable[[FinishedEpoch], object]  # Called after every epoch

    def training(self, files: Sequence[ScanFile], validation: Source) -> Training:
        """Return a training on some scans of the data set that scores others."""
        recipe = self.recipe
        data_set, *further = self.data.sources
        sources = [replace(data_set, files=files), *further]
        sets = class_sets(source.space for source in self.data.sources)
        points = self.data.counts.points
        scored = self.card.space.scored
        learner = Learner(
            copy.deepcopy(self.initial),
            recipe,
            class_weights(points, scored, recipe.class_weight),
            self.device,
            self.group,
            sets,
        )
        samples = Samples(
            sources=sources,
            sensor=data_set.sensor,
            recipe=recipe,
            rare=rare_classes(points, scored),
            sets=sets,
        )
        return Training(
            run=self.run,
            learner=learner,
            batches=self._batches(samples),
            validation=validation,
            card=replace(
                self.card,
                recipe={**recipe.to_dict(), **self.card.recipe},
                trained_on=self.card.trained_on | self._digests(sources),
            ),
            report=self.report,
            watch=EpochWatch(
                notify=self.watch, scans=validation if validation.files else sources[0]
            ),
        )

    def _batches(self, samples: Samples) -> BatchSource:
        """Return the source of the batches of a training."""
        if self.store is not None:
            return DeviceBatches(
                samples=samples, store=self.store, device=self.device, group=self.group
            )
        return WorkerBatches(
            samples=samples,
            workers=self.workers,
            pinned=self.device.type == "cuda",
            group=self.group,
        )

    def _digests(self, sources: Sequence[Source]) -> set[str]:
        """Return the digests of the scans of sources that are not simulated."""
        real = [source for source in sources if not source.simulated]
        return {self.data.counts.digests[file] for source in real for file in source.files}


def scan_store(recipe: Recipe, data: TrainingData, room: DeviceRoom, jobs: int) -> ScanStore:
    """Return the empty store of the scans of a training, which `jobs` threads read into it."""
    space = data.sources[0].space
    sets = class_sets(source.space for source in data.sources)
    rare = target_mask(rare_classes(data.counts.points, space.scored), sets, np.all)
    return ScanStore(
        memory=ScanMemory(device=room.device, reserve=room.reserve),
        sets=sets,
        rare=rare if recipe.paste else None,
        jobs=jobs,
    )
