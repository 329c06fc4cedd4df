# SPDX-License-Identifier: MIT
"""Cross-validated training: one training without each fold of the scans, then one on all scans."""

import copy
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.texts import percentage
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.weights.loading import network_of_module
from salsanext_cli.io.weights.weights import read_weights
from salsanext_cli.runs.loop.network_task import network_pipeline
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training import run_folder
from salsanext_cli.training.cross_validation import Expectation, Parts, expectation, held_out
from salsanext_cli.training.data.dataset import SamplingPlan
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.fit import FinishedEpoch, StepReport
from salsanext_cli.training.learner import network_in_training
from salsanext_cli.training.scoring.validation import validate
from salsanext_cli.training.setup import Setup
from salsanext_cli.training.tuning.error import (
    cross_validated,
    gains,
    has_both_kinds,
    is_better,
    judge_job,
    points_of_scan,
)
from salsanext_cli.training.tuning.error_training import JudgedPoints
from salsanext_cli.training.tuning.scans import LabelledImage, read_labelled_image

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidatedTraining:
    """Training whose folds estimate its scores, and choose its number of epochs."""

    setup: Setup  # Of the training on all scans, as its recipe states it

    @property
    def data_set(self) -> Source:
        """Scans that are divided into folds."""
        return self.setup.data.sources[0]

    def expectation(self) -> Expectation | None:
        """Train once without each fold of the scans and score it; None for a single scan."""
        folds = self._folds()
        if not folds:
            log.warning("a single labelled scan gives no estimate for other scans")
            return None
        logs = list[list[run_folder.Row]]()
        for number, (others, fold) in enumerate(folds, start=1):
            setup = self._setup_of_fold(number, len(folds), fold)
            self.setup.group.on_main(partial(_record_start, setup))
            scored = replace(self.data_set, files=fold)
            logs.append(setup.training(others, scored).fit().rows)
        one_drive = len({file.sequence for file in self.data_set.files}) == 1
        expected = expectation(logs, one_drive=one_drive)
        if expected is None:
            return None
        miou, accuracy = self._scores_before([fold for _, fold in folds])
        if expected.miou <= miou:
            after = f"{percentage(expected.miou)} on held-out scans"
            change = f"mean IoU {after}, {percentage(miou)} before"
            log.warning("training did not improve the weights: %s; label more locations", change)
        return replace(expected, miou_before=miou, accuracy_before=accuracy)

    def setup_of_all_scans(self, expected: Expectation | None) -> Setup:
        """Return the setup of the training on all scans, after the cross-validation."""
        setup = self.setup
        counts = [len(source.files) for source in setup.data.sources]
        before = len(self._folds()) * SamplingPlan(scan_counts=counts, recipe=setup.recipe).steps

        def report(step: StepReport) -> None:
            setup.report(replace(step, step=before + step.step, steps=before + step.steps))

        if expected is None:
            return replace(setup, report=report)
        card = replace(
            setup.card,
            scores=expected.scores(),
            temperature=expected.temperature,
            error=setup.group.on_main(partial(self._error_model, expected.temperature)),
        )
        recipe = setup.recipe.with_changes(epochs=expected.epochs)
        return replace(setup, recipe=recipe, card=card, report=report)

    def _folds(self) -> Parts:
        """Return the other scans and the scans of each fold."""
        return held_out(self.data_set.files, self.setup.recipe.folds)

    def _setup_of_fold(self, number: int, count: int, fold: Sequence[ScanFile]) -> Setup:
        """Return the setup of the training without a fold, the number-th of a count."""

        def report(step: StepReport) -> None:
            # A step of a fold is one of the whole cross-validation.
            done = (number - 1) * step.steps + step.step
            steps = (count + 1) * step.steps
            self.setup.report(replace(step, step=done, steps=steps, fold=number))

        def watch(epoch: FinishedEpoch) -> None:
            self.setup.watch(replace(epoch, page_folder=self.setup.run, fold=number, folds=count))

        return replace(
            self.setup,
            run=run_folder.fold_folder(self.setup.run, number),
            settings=replace(self.setup.settings, held_out=run_folder.scans_digest(fold)),
            report=report,
            watch=watch,
        )

    def _scores_before(self, folds: Sequence[Sequence[ScanFile]]) -> tuple[float, float]:
        """Return mean IoU and accuracy before training, means over the folds."""
        setup = self.setup
        module = copy.deepcopy(setup.initial).to(setup.device).eval()
        network = network_in_training(module, setup.card, setup.device)
        rows = [
            validate(network, replace(self.data_set, files=fold), setup.group)[0] for fold in folds
        ]
        miou, accuracy = np.nanmean([(row["miou"], row["accuracy"]) for row in rows], axis=0)
        return float(miou), float(accuracy)

    def _error_model(self, temperature: float) -> ErrorModel | None:
        """Fit an error model to the held-out scans of each fold, or return the existing one.

        None if neither is better than the confidence.
        """
        folds = [fold for _, fold in self._folds()]
        judged: dict[ScanFile, JudgedPoints] = {}
        for number, fold in enumerate(folds, start=1):
            judged |= self._judged_fold(number, fold, temperature)
        if has_both_kinds(judged.values()):
            existing_model = self.setup.error
            if existing_model and existing_model.features != FEATURES:
                existing_model = None
            fitted = cross_validated(judged, folds, start=existing_model)
            if gains(fitted.report):
                return fitted.model
            existing = fitted.report.held_out.existing
            confidence = fitted.report.held_out.confidence
            if existing_model and existing and confidence and is_better(existing, confidence):
                log.log(NOTICE, "the error model of the initial weights stays: it is no worse")
                return replace(existing_model, temperature=None)
        log.warning("no error model: it would be no better than the confidence")
        return None

    def _judged_fold(
        self, number: int, fold: Sequence[ScanFile], temperature: float
    ) -> dict[ScanFile, JudgedPoints]:
        """Judge the labels of a fold by the weights that were trained without it.

        In float32 on all devices: an overflow of a shorter type would end the trained folds.
        """
        data_set = self.data_set
        weights = run_folder.fold_folder(self.setup.run, number) / run_folder.LAST
        module, card = read_weights(weights)
        # The fold's own temperature was fitted to these very scans.
        card = replace(card, temperature=temperature)
        device = self.setup.device
        network = network_of_module(module.to(device), card, str(device))

        def read(file: ScanFile) -> LabelledImage:
            seen: Network = network.for_sensor(data_set.sensor_of(file))
            return read_labelled_image(file, seen, data_set.space)

        job = judge_job(network, read, points_of_scan(len(data_set.files)))
        points = network_pipeline(job, network).results(fold)
        return dict(zip(fold, points, strict=True))


def _record_start(setup: Setup) -> None:
    """Record the training of a fold in its folder, if this is free for it."""
    run_folder.require_free(setup.run, setup.settings, overwrite=setup.overwrite)
    run_folder.record_start(setup.run, setup.settings, overwrite=setup.overwrite)
