# SPDX-License-Identifier: MIT
"""Stage `train`: a labelled data set to a run folder with weights, log and curve."""

import logging
import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace, label_space
from salsanext_cli.errors import NOTICE, TrainingError, UsageError, counted
from salsanext_cli.measures.scan_summary import ScanWarning
from salsanext_cli.network.card import WeightsCard, default_weights, read_card
from salsanext_cli.parallel.run_options import cores, worker_count
from salsanext_cli.report.scan_pictures import draw_sample
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.selection import evenly_spaced
from salsanext_cli.sensors.sensor import Sensor
from salsanext_cli.stages.synth import SynthSettings, synthesise
from salsanext_cli.synthesis.rig import RIGS
from salsanext_cli.training.cross_validation import Expectation
from salsanext_cli.training.data.class_counts import ClassCounts, class_counts, require_labels
from salsanext_cli.training.data.sources import (
    Source,
    further_source,
    merged_into,
    scans_to_train_on,
    training_sources,
)
from salsanext_cli.training.distributed import group_of_environment, process_group
from salsanext_cli.training.fit import StepReport
from salsanext_cli.training.learner import common_precision
from salsanext_cli.training.log import Row
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import (
    BEST,
    CHECKPOINT,
    CLASS_COUNTS,
    LAST,
    STAGE,
    STREETS,
    TrainingSettings,
    begin,
    recorded_precision,
    require_free,
    training_settings,
)
from salsanext_cli.training.setup import Setup, inheriting, initial_network

MAX_LOADERS = 8  # Processes that prepare samples for a GPU, unless the user says how many
SCANS_OF_STREET, STREET_SPACING_M = 8, 10.0  # Of a simulated street

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TrainResult:
    """Result of a training."""

    best: Path  # Weights files: of the best validation, and of the end
    last: Path
    # Validation mIoU on points, after kNN, of the best weights; None without validation split
    best_miou: float | None
    rows: Sequence[Row]  # The log, a row per epoch
    warnings: list[ScanWarning]  # Reasons to doubt scans
    # What scans left out say of new ones, if there was a cross-validation
    expected: Expectation | None = None


@dataclass(frozen=True, slots=True)
class NewTraining:
    """Training that is about to begin, in its run folder."""

    roots: tuple[Path, ...]  # Of the data set and the further ones
    run: Path
    recipe: Recipe
    given: Sequence[Source]  # Scans trained on, scans for validation, further ones
    settings: TrainingSettings
    jobs: int

    def prepare(
        self, held: ExitStack, start: Path | None, *, overwrite: bool, strict: bool
    ) -> tuple[list[Source], ClassCounts]:
        """Keep other runs out of the folder, check it and the scans, and record the settings.

        Returns the scans for validation, those trained on and further ones, with the sensors that
        were fitted to them, and the counts of their classes.
        """
        run, recipe, first = self.run, self.recipe, self.given[0]
        held.enter_context(OwnedFolder(run, STAGE).open())
        require_free(run, self.settings, overwrite=overwrite)
        require_labels([file for source in self.given for file in source.files])
        streets = _simulated_streets(
            run / STREETS, recipe.streets, first.space, first.sensor, self.jobs
        )
        data, is_fitted = [*self.given, *streets], recipe.sensors == "fitted"
        first, scored, *others = training_sources(data, fit=is_fitted, jobs=self.jobs)
        kept, sources = run / CLASS_COUNTS, [first, *others]
        validated = evenly_spaced(scored.files, recipe.validation_scans)
        counts = class_counts(kept, sources, scored, validated, self.jobs, recipe.also)
        if strict and counts.warnings:
            found = (f"{w.code} in {counted(len(w.scans), 'scan')}" for w in counts.warnings)
            hint = "mend the scans or leave them out, or train without --strict"
            found_scans = f"doubtful scans: {', '.join(found)}"
            raise TrainingError(self.roots[0], found_scans, "none", hint)
        begin(run, self.settings, overwrite=overwrite)
        random = "random weights (--weights default: those of the package)"
        if not (run / CHECKPOINT).exists():
            log.log(NOTICE, "training from %s", start.name if start else random)
        return [replace(scored, files=validated), *sources], counts

    def card(
        self, card: WeightsCard, sources: Sequence[Source], weights: Path | None
    ) -> WeightsCard:
        """Return a card of weights that are trained on sources, from those in a file if any."""
        simulated = ", simulated streets" if len(sources) > len(self.roots) else ""
        names = ", ".join(path.resolve().name for path in self.roots)
        return replace(
            card,
            sensor=sources[0].sensor,
            # The recipe says which without --weights.
            recipe={"initial": read_card(weights).named(weights)} if weights else {},
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
    jobs: int | None = None,
    weights: Path | None = None,
    overwrite: bool = False,
    strict: bool = False,
    also: Sequence[Path] = (),
    progress: Callable[[StepReport], object] = lambda report: None,
) -> TrainResult:
    """Train a network, or resume a training that was interrupted in the same folder.

    A recipe with folds cross-validates scans without a validation split, then trains on all of
    them. Workers of torchrun share every batch. Without `jobs`, a GPU gets up to eight loaders.
    """
    _require_batch(recipe.batch, group_of_environment().size)
    start = default_weights() if weights is None and recipe.initial == "default" else weights
    with process_group(device) as (group, own_device), ExitStack() as held:
        workers = _workers(jobs, own_device.type)
        classes, training, validation = group.on_main(
            lambda: scans_to_train_on(dataset, space, divisible=recipe.folds > 0)
        )
        if recipe.precision == "auto":
            begun = group.on_main(lambda: None if overwrite else recorded_precision(run))
            recipe = replace(recipe, precision=begun or common_precision(own_device, group))
        initial, card = initial_network(start, classes, recipe, sensor)
        further = group.on_main(lambda: [further_source(p, classes, card.sensor) for p in also])
        given = [Source(files, classes, card.sensor) for files in (training, validation)] + further
        settings = training_settings(recipe, given, start)
        new = NewTraining((dataset, *also), run, recipe, given, settings, workers)
        prepare = partial(new.prepare, held, start, overwrite=overwrite, strict=strict)
        (scored, *sources), counts = group.on_main(prepare)
        setup = Setup(
            run=run,
            recipe=recipe,
            initial=initial,
            card=new.card(card, sources, weights),
            sources=sources,
            counts=counts,
            settings=settings,
            device=own_device,
            group=group,
            workers=workers if workers > 1 else 0,
            overwrite=overwrite,
            error=read_card(start).error if start else None,
            draw=draw_sample,
            report=progress,
        )
        outlook = None if validation else setup.cross_validated()
        setup = setup if validation else setup.after(outlook)
        if start and not outlook:
            setup = replace(setup, card=inheriting(setup.card, start))
        state = setup.training(training, scored).fit()
    best = state.best if validation else None
    return TrainResult(run / BEST, run / LAST, best, state.rows, counts.warnings, outlook)


def _workers(jobs: int | None, kind: str) -> int:
    """Return the number of processes that prepare samples; by default one on a CPU."""
    workers_here = int(os.environ.get("LOCAL_WORLD_SIZE", 1))
    usual = 1 if kind == "cpu" else max(1, min(MAX_LOADERS, cores() // workers_here))
    return usual if jobs is None else worker_count(jobs)


def _require_batch(samples: int, workers: int) -> None:
    if samples < workers:
        expected = f"at least one sample for each of {workers} workers"
        hint = "start fewer workers or set batch higher"
        raise UsageError("recipe key batch", f"{samples}", expected, hint)


def _simulated_streets(
    folder: Path, count: int, classes: LabelSpace, sensor: Sensor, jobs: int
) -> list[Source]:
    """Return data sets of streets, by kind of sensor, made if need be; none for other classes."""
    if not count:
        return []
    if merged_into(label_space(), classes) is None:
        log.log(NOTICE, "no simulated streets: they tell other classes apart than your labels")
        return []
    roots = {kind: folder / kind for kind in RIGS}
    splits = {"train": count, "valid": 0, "test": 0}
    for kind, root in roots.items():
        wanted = SynthSettings.of(splits, SCANS_OF_STREET, 0, STREET_SPACING_M, kind).record
        if (recorded := Manifest(root).record(wanted.stage)) != wanted:
            why = ": those there are of another version or settings" if recorded else ""
            log.log(NOTICE, "simulating %s in %s%s", counted(count, "street"), root, why)
        synthesise(
            root,
            train=count,
            valid=0,
            scans=SCANS_OF_STREET,
            seed=0,
            spacing=STREET_SPACING_M,
            sensor=kind,
            jobs=jobs,
            overwrite=recorded not in (None, wanted),
        )
    sources = [further_source(root, classes, sensor) for root in roots.values()]
    return [replace(source, simulated=True) for source in sources]
