# SPDX-License-Identifier: MIT
"""Setup of a training: its initial network, its data, its cross-validation."""

import copy
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.backend import LOGITS
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import INHERITED, WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.network.registry import build, described
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import first_few, percentage
from salsanext_cli.core.uncertainty.error_features import FEATURES
from salsanext_cli.io.sensors import sensor
from salsanext_cli.io.weights.card_file import named_weights, read_card
from salsanext_cli.io.weights.loading import network_of_module
from salsanext_cli.io.weights.weights import read_weights
from salsanext_cli.runs.loop.network_task import network_pipeline
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.training import run_folder
from salsanext_cli.training.cross_validation import Expectation, Parts, expectation, held_out
from salsanext_cli.training.data.class_counts import ClassCounts, class_weights, rare_classes
from salsanext_cli.training.data.dataset import Samples, SamplingPlan
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.data.targets import class_sets
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.fit import StepReport, Training
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.tuning.error import (
    JudgedPoints,
    cross_validated,
    gains,
    is_better,
    judge_job,
    of_both_kinds,
    points_of_scan,
)
from salsanext_cli.training.tuning.scans import LabelledImage, read_labelled_image
from salsanext_cli.training.validation import validate

DEFAULT_SENSOR = "hdl64"  # Sensor of a training from random weights, unless another is given

log = logging.getLogger(__name__)


def initial_network(
    weights: Path | None, space: LabelSpace, recipe: Recipe, seen: Sensor | None
) -> tuple[SegmentationNetwork, WeightsCard]:
    """Return the network before training and its card: architecture, classes, sensor, scans.

    It is random without weights; so are the outputs of classes that the weights do not have. The
    sensor is `seen`, else that of the weights, else the default; the recipe may set its width.
    """
    architecture = described(
        recipe.architecture, class_count=space.class_count, dropout=recipe.dropout
    )
    widths = tuple(dict.fromkeys(recipe.image_widths))
    with torch.random.fork_rng([]):
        torch.manual_seed(recipe.seed)  # noqa: TID251
        module = build(architecture, "recipe key architecture")
    if weights is None:
        chosen = _sensor_of_training(seen, sensor(DEFAULT_SENSOR), recipe)
        return module, WeightsCard(architecture, space, chosen, widths=widths)
    trained, card = read_weights(weights)
    if _hidden_shapes(trained) != _hidden_shapes(module):
        name = card.architecture["name"]
        hint = f'set architecture = "{name}" in the recipe'
        raise WeightsError(weights, f"is a {name}", f"a {recipe.architecture}", hint)
    tensors = trained.state_dict()
    if not card.space.fits(space):
        tensors |= _outputs(module, tensors, card.space, space)
    module.load_state_dict(tensors)
    chosen = _sensor_of_training(seen, card.sensor, recipe)
    begun = WeightsCard(architecture, space, chosen, trained_on=card.trained_on, widths=widths)
    return module, begun


def inheriting(card: WeightsCard, weights: Path) -> WeightsCard:
    """Return a card with error model and estimated accuracy of the initial weights, marked."""
    initial = read_card(weights)
    error, name = initial.error, named_weights(initial, weights)
    fits = initial.space.fits(card.space) and (error is None or error.features == FEATURES)
    error = error and replace(error, scores={INHERITED: name, **error.scores})
    accuracy = initial.accuracy
    if accuracy and not accuracy.inherited_from:
        accuracy = replace(accuracy, inherited_from=name)
    heir = replace(card, temperature=initial.temperature, error=error, accuracy=accuracy)
    if inherited := heir.inherited():
        status = "inherited" if fits else "not inherited, since classes or features differ"
        log.log(NOTICE, "%s: %s; fit a model with `salsanext tune error`", status, inherited)
    return heir if inherited and fits else card


def _sensor_of_training(seen: Sensor | None, trained: Sensor, recipe: Recipe) -> Sensor:
    """Return the sensor of a training: its intensity and row gaps are by default the trained ones.

    The first width of the recipe, if it names any, is that of its images.
    """
    chosen = trained if seen is None else seen
    quantiles = chosen.intensity_quantiles or trained.intensity_quantiles
    gaps = trained.row_gaps if chosen.row_gaps is None else chosen.row_gaps
    completed = replace(chosen, intensity_quantiles=quantiles, row_gaps=gaps)
    return completed.resized(width=recipe.image_widths[0] if recipe.image_widths else None)


def _outputs(
    module: SegmentationNetwork,
    trained: Mapping[str, Tensor],
    classes: LabelSpace,
    space: LabelSpace,
) -> dict[str, Tensor]:
    """Return the tensors of the outputs, (C, …), with the trained values of shared classes."""
    outputs = {f"{LOGITS}.{key}": t.clone() for key, t in module.logits.state_dict().items()}
    trained_ids = {name: i for i, name in enumerate(classes.names)}
    shared = [i for i, name in enumerate(space.names) if name in trained_ids]
    for name, tensor in outputs.items():
        tensor[shared] = trained[name][[trained_ids[space.names[i]] for i in shared]]
    new = [name for name in space.names if name not in trained_ids]
    text = f"; at random: {first_few(new)}" if new else ""
    log.log(NOTICE, "weights of %d of %d classes reused%s", len(shared), space.class_count, text)
    return outputs


def _hidden_shapes(module: SegmentationNetwork) -> dict[str, torch.Size]:
    """Return the shapes of the tensors of all layers except the outputs, by name."""
    tensors = module.state_dict().items()
    return {name: tensor.shape for name, tensor in tensors if not name.startswith(f"{LOGITS}.")}


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Everything that a training needs, except the choice of its scans."""

    run: Path
    recipe: Recipe
    initial: SegmentationNetwork  # The network before training
    # Of the weights files; recipe: the keys that differ; trained_on: scans of the initial weights
    card: WeightsCard
    sources: Sequence[Source]  # All labelled scans of the data set, and further data sets
    counts: ClassCounts
    settings: run_folder.TrainingSettings
    device: torch.device
    group: ProcessGroup
    workers: int
    overwrite: bool
    error: ErrorModel | None  # Error model of the initial weights
    report: Callable[[StepReport], object]  # Called after every step

    def training(self, files: Sequence[ScanFile], validation: Source) -> Training:
        """Return a training on some scans of the data set that scores others."""
        recipe, (first, *further) = self.recipe, self.sources
        of_class = self.counts.points, self.card.space.scored
        weights = class_weights(*of_class, recipe.class_weight)
        module = copy.deepcopy(self.initial)
        trained_on = [replace(first, files=files), *further]
        real = [source for source in trained_on if not source.simulated]
        digests = {self.counts.digests[file] for source in real for file in source.files}
        sets = class_sets(source.space for source in self.sources)
        return Training(
            run=self.run,
            learner=Learner(module, recipe, weights, self.device, self.group, sets),
            samples=Samples(trained_on, first.sensor, recipe, rare_classes(*of_class), sets),
            validation=validation,
            card=replace(
                self.card,
                recipe={**recipe.to_dict(), **self.card.recipe},
                trained_on=self.card.trained_on | digests,
            ),
            workers=self.workers,
            report=self.report,
        )

    def cross_validated(self) -> Expectation | None:
        """Train once without each fold of the scans and score it; None for a single scan."""
        first, parts, logs = self.sources[0], self._parts(), list[list[run_folder.Row]]()
        if not parts:
            log.warning("a single labelled scan gives no estimate for other scans")
            return None
        for number, (rest, part) in enumerate(parts, start=1):
            fold = replace(
                self,
                run=run_folder.fold_folder(self.run, number),
                settings=replace(self.settings, held_out=run_folder.scans_digest(part)),
                report=partial(self._report_fold, number, len(parts)),
            )
            self.group.on_main(fold._record_start)
            logs.append(fold.training(rest, replace(first, files=part)).fit().rows)
        one_drive = len({file.sequence for file in first.files}) == 1
        if (expected := expectation(logs, one_drive=one_drive)) is None:
            return None
        miou, accuracy = self._scores_before([part for _, part in parts])
        if expected.miou <= miou:
            after = f"{percentage(expected.miou)} on held-out scans"
            change = f"mean IoU {after}, {percentage(miou)} before"
            log.warning("training did not improve the weights: %s; label more locations", change)
        return replace(expected, miou_before=miou, accuracy_before=accuracy)

    def _scores_before(self, parts: Sequence[Sequence[ScanFile]]) -> tuple[float, float]:
        """Return mean IoU and accuracy before training, means over the folds."""
        module, first = copy.deepcopy(self.initial).to(self.device).eval(), self.sources[0]
        network = network_of_module(module, self.card, str(self.device))
        rows = [validate(network, replace(first, files=part), self.group)[0] for part in parts]
        miou, accuracy = np.nanmean([(row["miou"], row["accuracy"]) for row in rows], axis=0)
        return float(miou), float(accuracy)

    def after(self, expected: Expectation | None) -> "Setup":
        """Return the setup of the training on all scans, after a cross-validation."""
        counts = [len(source.files) for source in self.sources]
        before = len(self._parts()) * SamplingPlan(counts, self.recipe).steps

        def report(step: StepReport) -> None:
            self.report(replace(step, step=before + step.step, steps=before + step.steps))

        if expected is None:
            return replace(self, report=report)
        card = replace(
            self.card,
            scores=expected.scores(),
            temperature=expected.temperature,
            error=self.group.on_main(partial(self._error_model, expected.temperature)),
        )
        recipe = self.recipe.with_changes(epochs=expected.epochs)
        return replace(self, recipe=recipe, card=card, report=report)

    def _parts(self) -> Parts:
        return held_out(self.sources[0].files, self.recipe.folds)

    def _record_start(self) -> None:
        run_folder.require_free(self.run, self.settings, overwrite=self.overwrite)
        run_folder.record_start(self.run, self.settings, overwrite=self.overwrite)

    def _report_fold(self, number: int, count: int, report: StepReport) -> None:
        """Report a step of a fold as one of the whole cross-validation."""
        done, steps = (number - 1) * report.steps + report.step, (count + 1) * report.steps
        self.report(replace(report, step=done, steps=steps, fold=number))

    def _error_model(self, temperature: float) -> ErrorModel | None:
        """Fit an error model to the held-out scans of each fold, or return the existing one.

        None if neither is better than the confidence.
        """
        source, parts = self.sources[0], [part for _, part in self._parts()]
        judged: dict[ScanFile, JudgedPoints] = {}
        for number, part in enumerate(parts, start=1):
            module, card = read_weights(run_folder.fold_folder(self.run, number) / run_folder.LAST)
            # The fold's own temperature was fitted to these very scans.
            card = replace(card, temperature=temperature)
            network = network_of_module(module.to(self.device), card, str(self.device))

            def read(file: ScanFile, network: Network = network) -> LabelledImage:
                seen = network.for_sensor(source.sensor_of(file))
                return read_labelled_image(file, seen, source.space)

            job = judge_job(network, read, points_of_scan(len(source.files)))
            judged |= zip(part, network_pipeline(job, network).results(part), strict=True)
        if of_both_kinds(judged.values()):
            start = self.error if self.error and self.error.features == FEATURES else None
            model = cross_validated(judged, parts, start=start)
            if gains(model):
                return model
            existing = model.scores["existing"]
            if start and existing and is_better(existing, model.scores["confidence"]):
                log.log(NOTICE, "the error model of the initial weights stays: it is no worse")
                return replace(start, temperature=None)
        log.warning("no error model: it would be no better than the confidence")
        return None
