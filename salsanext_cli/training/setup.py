# SPDX-License-Identifier: MIT
"""Setup of a training: what trainings on parts of the same data share, cross-validation of them."""

import copy
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
import torch

from salsanext_cli.engines.network import Network
from salsanext_cli.errors import UsageError
from salsanext_cli.network.card import WeightsCard, read_card
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.sensors.sensor import Sensor
from salsanext_cli.training.cross_validation import Expectation, expectation, folds
from salsanext_cli.training.data.class_counts import ClassCounts, class_weights, rare_classes
from salsanext_cli.training.data.dataset import Samples, SamplingPlan
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.data.targets import ClassSets
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.fit import StepReport, Training
from salsanext_cli.training.fold_errors import error_of_folds
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.log import Row, tensorboard_in
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import (
    BEST,
    CHECKPOINT,
    EVENTS,
    begin,
    fold_folder,
    require_free,
)
from salsanext_cli.training.settings import scans_digest

log = logging.getLogger(__name__)


def require_pixels(
    recipe: Recipe, sensor: Sensor, module: SegmentationNetwork, group: ProcessGroup
) -> None:
    """Refuse images whose coarsest level has one pixel: batch norm needs two to differ."""
    part = recipe.batch // group.size // min(recipe.accumulate, recipe.batch // group.size)
    size = (sensor.height, min(recipe.crop_width or sensor.width, sensor.width))
    coarsest = [-(-pixels // step) for pixels, step in zip(size, module.stride, strict=True)]
    if part * math.prod(coarsest) == 1:
        found = f"one pixel is left of one image of {size[0]}×{size[1]}"
        raise UsageError("recipe key crop_width", found, "two pixels for batch norm at least")


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """All that a training needs but its scans.

    `initial` is the network before training. The card of the weights files has no scores; of the
    recipe it has keys with other values than the recipe's, of the scans trained on those of the
    weights that it begins from. `sources` are all labelled scans of the data set, and further data
    sets; `settings` all that decides the result. `draw` draws a network's predictions for a scan
    into an open file and returns the picture; `report` is called after every step; `held` is closed
    after the training.
    """

    run: Path
    recipe: Recipe
    initial: SegmentationNetwork
    card: WeightsCard
    sources: Sequence[Source]
    counts: ClassCounts
    sets: ClassSets
    settings: Mapping[str, Any]
    place: torch.device
    group: ProcessGroup
    workers: int
    overwrite: bool
    draw: Callable[[BinaryIO, ScanFile, Network], npt.NDArray[np.uint8]]
    report: Callable[[StepReport], object]
    held: ExitStack

    def training(
        self,
        files: Sequence[ScanFile],
        validation: Source,
        folder: Path | None = None,
        report: Callable[[StepReport], object] | None = None,
    ) -> Training:
        """Return a training on some scans of the data set that scores others.

        Folder and report are those of the setup, unless others are given.
        """
        folder, recipe = folder or self.run, self.recipe
        first, *further = self.sources
        of_class = self.counts.points, self.card.space.scored
        drawn = (validation.files or files)[0]
        tensorboard = tensorboard_in(folder, EVENTS, wanted=self.group.is_main)
        shown = validation if validation.files else first

        def draw(file: BinaryIO, network: Network) -> npt.NDArray[np.uint8]:
            return self.draw(file, drawn, network.for_sensor(shown.sensor_of(drawn)))

        weights = class_weights(*of_class, recipe.class_weight)
        module = copy.deepcopy(self.initial)
        trained_on = [replace(first, files=files), *further]
        real = (source.files for source in trained_on if not source.simulated)
        digests = {self.counts.digests[file] for file in chain.from_iterable(real)}
        card = replace(
            self.card,
            recipe={**recipe.to_dict(), **self.card.recipe},
            trained_on=self.card.trained_on | digests,
        )
        return Training(
            run=folder,
            learner=Learner(module, recipe, weights, self.place, self.group, self.sets),
            samples=Samples(trained_on, first.sensor, recipe, rare_classes(*of_class), self.sets),
            validation=validation,
            card=card,
            workers=self.workers,
            draw=draw,
            write_epoch=self.held.enter_context(tensorboard),
            report=report or self.report,
        )

    def after(self, expected: Expectation | None) -> "Setup":
        """Return the setup of the training on all scans, after a cross-validation.

        Its weights have a model of errors that was fitted to the scans that each fold left out.
        """
        counts = [len(source.files) for source in self.sources]
        before = len(self._folds()) * SamplingPlan(counts, self.recipe).steps

        def report(own: StepReport) -> None:
            self.report(replace(own, step=before + own.step, steps=before + own.steps))

        if expected is None:
            return replace(self, report=report)
        scans = self.sources[0], self._folds()
        fitted = partial(error_of_folds, self.run, *scans, expected.temperature, self.place)
        return replace(
            self,
            recipe=self.recipe.with_changes(epochs=expected.epochs),
            card=replace(
                self.card,
                scores=expected.scores(),
                temperature=expected.temperature,
                error=self.group.on_main(fitted),
            ),
            report=report,
        )

    def cross_validated(self) -> Expectation | None:
        """Train once without each fold of the scans, and score it; None of a single scan.

        The best weights so far are those of the run until its own training ends.
        """
        first, parts, logs = self.sources[0], self._folds(), list[list[Row]]()
        if not parts:
            log.warning("one labelled scan: what to expect on others is unknown")
            return None
        for number, part in enumerate(parts, start=1):
            left_out, folder = replace(first, files=part), fold_folder(self.run, number)
            settings = {**self.settings, "left_out": scans_digest(part)}
            self.group.on_main(partial(self._begin, folder, settings))
            files = [file for file in first.files if file not in part]
            report = partial(self._report_fold, number, len(parts))
            logs.append(self.training(files, left_out, folder, report=report).fit().rows)
        return expectation(logs, one_drive=len({file.sequence for file in first.files}) == 1)

    def _folds(self) -> list[list[ScanFile]]:
        files = self.sources[0].files
        return folds(files, self.recipe.folds) if len(files) > 1 else []

    def _begin(self, folder: Path, settings: Mapping[str, Any]) -> None:
        require_free(folder, settings, overwrite=self.overwrite)
        begin(folder, settings, overwrite=self.overwrite)

    def _report_fold(self, number: int, count: int, report: StepReport) -> None:
        """StepReport a step as one of the whole cross-validation and the training after it.

        After an epoch, the best weights of the fold become those of the run if they are better.
        """
        best, own = self.run / BEST, fold_folder(self.run, number) / BEST
        if report.row and own.exists() and not (self.run / CHECKPOINT).exists():
            scores = [
                read_card(path).scores.get("miou", -1.0) for path in (best, own) if path.exists()
            ]
            if len(scores) == 1 or scores[1] > scores[0]:
                OwnedFolder(self.run).write(best, own.read_bytes(), durable=True)
        done, steps = (number - 1) * report.steps + report.step, (count + 1) * report.steps
        self.report(replace(report, step=done, steps=steps, fold=number))
