# SPDX-License-Identifier: MIT
"""Training loop: steps, validation, log, weights and checkpoint of every epoch."""

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.wording import setting
from salsanext_cli.io.weights.weights import encode_weights
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.training.checkpoint import TrainingState, load_checkpoint, save_checkpoint
from salsanext_cli.training.data.batch_source import BatchSource
from salsanext_cli.training.data.dataset import Batch, SamplingPlan
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.learner import Learner, learning_rate
from salsanext_cli.training.run_folder import BEST, CHECKPOINT, LAST, LOG, Row, write_log
from salsanext_cli.training.scoring.validation import validate_widths

SAVE_INTERVAL_S = 600.0  # Seconds between two checkpoints within an epoch
CHECK_INTERVALS = {"cpu": 1, "cuda": 16}  # Steps between two reads of losses, which wait

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepReport:
    """Progress of a training after a step, counted from 1 as epochs are."""

    epoch: int
    epochs: int
    step: int
    steps: int
    row: Row | None = None  # Finished line of the log, after the last step of an epoch
    fold: int = 0  # Number of the fold of a cross-validation, from 1; 0 for the training itself


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FinishedEpoch:
    """Training after an epoch whose weights and log are written."""

    run: Path  # Folder of the training, or of a fold
    page_folder: Path  # Folder of the page that shows the epoch, that of the training
    rows: Sequence[Row]  # The log so far; the last row is that of the epoch
    epochs: int  # Number of all epochs
    network: Network  # Network of the last weights
    scans: Source  # Validation scans; training scans if there are none
    is_validation: bool  # Whether these are validation scans
    fold: int = 0  # Number of the fold of a cross-validation, from 1; 0 for the training itself
    folds: int = 0  # Number of folds


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EpochWatch:
    """What to call after every epoch, in the main worker alone."""

    notify: Callable[[FinishedEpoch], object]
    scans: Source  # As of `FinishedEpoch`


@dataclass(slots=True, eq=False, kw_only=True)
class Training:
    """Training in a run folder; without validation scans the last weights are the best."""

    run: Path
    learner: Learner
    batches: BatchSource
    validation: Source
    card: WeightsCard
    report: Callable[[StepReport], object]  # Called after every step, in the main worker alone
    watch: EpochWatch | None = None
    watch_failed: bool = False  # Whether the watch raised an error, which is logged once

    @property
    def plan(self) -> SamplingPlan:
        """Order of the samples of all workers."""
        return self.batches.samples.plan

    def fit(self) -> TrainingState:
        """Train from the last checkpoint, if there is one, to the end."""
        saved = self.run / CHECKPOINT
        steps = self.plan.steps_per_epoch
        state = load_checkpoint(saved, self.learner) if saved.exists() else TrainingState()
        first = state.epoch * steps + len(state.losses)
        group = self.learner.group
        step_of_main = group.on_main(lambda: first)
        if step_of_main != first:
            steps_differ = f"step {step_of_main} for the first worker, {first} for this"
            problem = f"has a checkpoint of {steps_differ}"
            raise TrainingError(self.run, problem, "one folder that all workers share")
        epochs = self.learner.recipe.epochs
        if first and group.is_main:
            action = "resuming" if state.epoch < epochs else "complete"
            where = f"{state.epoch} of {epochs} epochs, step {first}, from {saved}"
            log.log(NOTICE, "%s after %s", action, where)
        stream = self.batches.batches(first)
        while state.epoch < epochs:
            self._epoch(state, stream)
            self._end_epoch(state)
        return group.on_main(lambda: state)

    def _epoch(self, state: TrainingState, stream: Iterator[Batch]) -> None:
        """Take the remaining steps of an epoch, and report all but the last."""
        saved = time.monotonic()
        start = saved - state.seconds
        end = (state.epoch + 1) * self.plan.steps_per_epoch
        first = end - self.plan.steps_per_epoch + len(state.losses)
        interval = CHECK_INTERVALS[self.learner.device.type]
        unchecked: list[Tensor] = []  # Losses of the last steps
        for step, batch in enumerate(islice(stream, end - first), first):
            unchecked.append(self._step(batch, step))
            is_last = step + 1 == end
            due = time.monotonic() - saved > SAVE_INTERVAL_S
            if is_last or due or len(unchecked) == interval:
                state.losses += self._checked(unchecked, step)
                unchecked.clear()
            state.seconds = time.monotonic() - start
            if is_last:
                break
            if due:
                saved = time.monotonic()
                if self.learner.group.is_main:
                    save_checkpoint(self.run / CHECKPOINT, self.learner, state)
            self._report(state, step)

    def _end_epoch(self, state: TrainingState) -> None:
        """Validate, write and report an epoch whose steps are done."""
        recipe = self.learner.recipe
        steps = self.plan.steps_per_epoch
        losses = state.losses
        seconds = state.seconds
        group = self.learner.group
        card = self.card
        state.epoch = state.epoch + 1
        state.losses = []
        state.seconds = 0.0
        step = state.epoch * steps - 1
        row: Row = {
            "epoch": state.epoch,
            "learning_rate": learning_rate(recipe, step, steps),
            "loss": float(np.mean(losses)),
            "seconds": seconds,
        }
        due = state.epoch == recipe.epochs or state.epoch % recipe.validate_every == 0
        if due and self.validation.files:
            # On CPUs the workers' statistics of batch norm differ; the main worker's are saved.
            group.broadcast(self.learner.average.buffers())
            widths = recipe.image_widths
            measured, card = validate_widths(
                self.learner.network(self.card), self.validation, widths, group
            )
            row |= measured
        if group.is_main:
            self._write(state, row, card)
            if self.watch:
                self._notify(self.watch, state)
            # Last, so that a training that is killed before repeats the epoch with its pictures.
            save_checkpoint(self.run / CHECKPOINT, self.learner, state)
        self._report(state, step, row)

    def _notify(self, watch: EpochWatch, state: TrainingState) -> None:
        """Call what shows an epoch; an error there does not end the training."""
        try:
            watch.notify(self._finished(state, watch.scans))
            return
        except Exception as error:  # noqa: BLE001 - of any library that draws
            if not self.watch_failed:
                message = "%s: pictures after epoch %d failed, and the training goes on: %s"
                log.warning(message, self.run, state.epoch, error)
            self.watch_failed = True
        # The error, which holds memory, is gone here.
        if self.learner.device.type == "cuda":
            torch.cuda.empty_cache()

    def _finished(self, state: TrainingState, scans: Source) -> FinishedEpoch:
        """Return what can be shown of an epoch, with predictions of some scans."""
        return FinishedEpoch(
            run=self.run,
            page_folder=self.run,
            rows=state.rows,
            epochs=self.learner.recipe.epochs,
            network=self.learner.network(self.card),
            scans=scans,
            is_validation=bool(self.validation.files),
        )

    def _step(self, batch: Batch, step: int) -> Tensor:
        images, truth = batch
        try:
            return self.learner.step(images, truth, step, self.plan.steps_per_epoch)
        except torch.OutOfMemoryError as error:
            if not self.batches.free_device():
                problem = f"not enough memory on {self.learner.device} for {len(images)} images"
                hint = f"compute a batch in more parts, such as {setting('recipe.accumulate', 2)}"
                raise TrainingError(f"step {step + 1}", problem, hint=hint) from error
        # The error, which holds memory, is gone here.
        return self._step(batch, step)

    def _checked(self, losses: list[Tensor], last: int) -> list[float]:
        """Return the losses of the steps up to the last; raise an error that names the scans."""
        values: list[float] = torch.stack(losses).tolist()
        first = last + 1 - len(values)
        for step, value in enumerate(values, first):
            if not math.isfinite(value):
                files = ", ".join(map(str, self.batches.paths(step)))
                problem = f"loss or gradient is not finite with {files}"
                hint = "check these scans, lower learning_rate or set clip_gradient"
                raise TrainingError(f"step {step + 1}", problem, hint=hint)
        return values

    def _write(self, state: TrainingState, row: Row, card: WeightsCard) -> None:
        """Write weights and log."""
        state.rows.append(row)
        scored = {k: v for k, v in row.items() if ("iou" in k or k == "accuracy") and v == v}
        written = OwnedFolder(self.run)
        card = replace(card, scores={**card.scores, **scored, "epoch": state.epoch})
        weights = encode_weights(self.learner.average, card)
        written.write(self.run / LAST, weights, durable=True)
        last_of_all = not self.validation.files and state.epoch == self.learner.recipe.epochs
        if row.get("miou", -1) > state.best or last_of_all:
            state.best = row.get("miou", state.best)
            written.write(self.run / BEST, weights, durable=True)
        write_log(self.run / LOG, state.rows)

    def _report(self, state: TrainingState, step: int, row: Row | None = None) -> None:
        if self.learner.group.is_main:
            is_running = row is None
            epoch = state.epoch + 1 if is_running else state.epoch
            epochs = self.learner.recipe.epochs
            self.report(
                StepReport(
                    epoch=epoch, epochs=epochs, step=step + 1, steps=self.plan.steps, row=row
                )
            )
