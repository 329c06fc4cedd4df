# SPDX-License-Identifier: MIT
"""Epoch after epoch: learn, validate, write down, keep the best."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from salsanext_cli.errors import TrainingError
from salsanext_cli.inference.network import Network
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.scores import scores
from salsanext_cli.network.weights import WeightsCard, save_weights
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.training.checkpoint import TrainingState, load_checkpoint, save_checkpoint
from salsanext_cli.training.dataset import Batch, Samples, batches
from salsanext_cli.training.events import Events
from salsanext_cli.training.log import Row, draw_curve, write_log
from salsanext_cli.training.non_finite import non_finite_samples
from salsanext_cli.training.optimise import Learner
from salsanext_cli.training.plan import Plan
from salsanext_cli.training.precision import autocast
from salsanext_cli.training.schedule import learning_rate
from salsanext_cli.training.validation import validate

CHECKPOINT = "checkpoint.pt"
LAST, BEST = "last.safetensors", "best.safetensors"
LOG, CURVE, SAMPLES = "log.csv", "curve.png", "samples"
SAVE_EVERY = 600.0
"""Seconds between two checkpoints within an epoch."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Report:
    """Where training stands after a step.

    Attributes
    ----------
    epoch, epochs : int
        The epoch at work, from 1, and how many there are.
    step, steps : int
        Steps done and steps of the whole training.
    loss : float
        Of this step.
    row : Row or None
        The finished line of the log after the last step of an epoch.
    """

    epoch: int
    epochs: int
    step: int
    steps: int
    loss: float
    row: Row | None = None


@dataclass(slots=True, eq=False)
class Training:
    """Everything that a training needs.

    Attributes
    ----------
    run : Path
        Where log, curve, weights and checkpoint go.
    learner : Learner
    samples : Samples
        What to learn from.
    validation : sequence of ScanFile
        What to score on at every validation.
    card : WeightsCard
        What the weights files will say, scores aside.
    workers : int
        Processes that prepare samples.
    draw : callable
        Draws what a network makes of a scan into a file, and returns the picture, (H, W, 3).
    events : Events
        Notes epochs for TensorBoard.
    report : callable
        Called after every step; in a team by the leader, who alone writes.
    """

    run: Path
    learner: Learner
    samples: Samples
    validation: Sequence[ScanFile]
    card: WeightsCard
    workers: int
    draw: Callable[[Path, Network], npt.NDArray[np.uint8]]
    events: Events
    report: Callable[[Report], object]

    @property
    def plan(self) -> Plan:
        """What is drawn when."""
        return Plan(len(self.samples.files), self.learner.recipe)

    def fit(self) -> TrainingState:
        """Train from the last checkpoint, if there is one, to the end."""
        checkpoint = self.run / CHECKPOINT
        state = (
            load_checkpoint(checkpoint, self.learner) if checkpoint.exists() else TrainingState()
        )
        if len(state.losses) >= self.plan.steps_per_epoch:
            found = f"{len(state.losses)} steps of an epoch of {self.plan.steps_per_epoch}"
            raise TrainingError(checkpoint, found, "a checkpoint of this training")
        first = state.epoch * self.plan.steps_per_epoch + len(state.losses)
        self._require_same_start(first)
        if first:
            log.info("going on after step %d", first)
        pinned = self.learner.device.type == "cuda"
        group = self.learner.group
        stream = batches(self.samples, self.plan, first, self.workers, pinned=pinned, group=group)
        while state.epoch < self.learner.recipe.epochs:
            self._epoch(state, stream)
        return group.on_main(lambda: state)

    def _require_same_start(self, first: int) -> None:
        """Refuse a team of which some go on and some begin: they do not see the same folder."""
        is_main = self.learner.group.on_main(lambda: first)
        if is_main != first:
            raise TrainingError(
                self.run,
                f"the first worker goes on after step {is_main}, this one after step {first}",
                "one folder that all workers see",
            )

    def _epoch(self, state: TrainingState, stream: Iterator[Batch]) -> None:
        """Take the steps of an epoch that are left, and end it."""
        saved = time.monotonic()
        start = saved - state.seconds
        end = (state.epoch + 1) * self.plan.steps_per_epoch
        first = end - self.plan.steps_per_epoch + len(state.losses)
        for step, batch in enumerate(islice(stream, end - first), first):
            state.losses.append(self._step(batch, step))
            now = time.monotonic()
            state.seconds = now - start
            if step + 1 == end:
                break
            if now - saved > SAVE_EVERY and self.learner.group.is_main:
                save_checkpoint(self.run / CHECKPOINT, self.learner, state)
                saved = now
            self._tell(state, step, state.losses[-1])
        self._end_epoch(state, step)

    def _end_epoch(self, state: TrainingState, step: int) -> None:
        loss, losses, seconds = state.losses[-1], state.losses, state.seconds
        state.epoch, state.losses, state.seconds = state.epoch + 1, [], 0.0
        row: Row = {
            "epoch": state.epoch,
            "learning_rate": learning_rate(self.learner.recipe, step, self.plan.steps_per_epoch),
            "loss": float(np.mean(losses)),
            "seconds": seconds,
        }
        last = state.epoch == self.learner.recipe.epochs
        if last or state.epoch % self.learner.recipe.validate_every == 0:
            row |= self._scores()
        if self.learner.group.is_main:
            self._keep(state, row)
        self._tell(state, step, loss, row)

    def _step(self, batch: Batch, step: int) -> float:
        images, truth, _ = batch
        try:
            loss = self.learner.step(images, truth, step, self.plan.steps_per_epoch)
        except torch.OutOfMemoryError as error:
            raise TrainingError(
                f"step {step + 1}",
                f"no memory is left on {self.learner.device} for {len(images)} images",
                "images that fit",
                "--set accumulate=2, or more parts still",
            ) from error
        if not math.isfinite(loss):
            raise TrainingError(
                f"step {step + 1}",
                f"the loss or its gradient is not finite with {self._culprits(batch)}",
                "finite ones",
                "look at these scans, lower learning_rate or set clip_gradient",
            )
        return loss

    def _culprits(self, batch: Batch) -> str:
        """Name the scans whose loss alone is not finite; all of the batch if there are none."""
        images, truth, indices = (each.to(self.learner.device) for each in batch)
        with autocast(self.learner.dtype, self.learner.device):
            alone = non_finite_samples(self.learner.network, self.learner.loss, images, truth)
        found, every = (torch.cat(self.learner.group.gather(i)) for i in (indices[alone], indices))
        chosen = found if len(found) else every
        return ", ".join(str(self.samples.files[i].path) for i in chosen)

    def _keep(self, state: TrainingState, row: Row) -> None:
        """Write weights, log, curve, pictures and, last, the checkpoint."""
        state.rows.append(row)
        scores = {key: value for key, value in row.items() if "iou" in key and value == value}
        card = replace(self.card, scores=scores | {"epoch": state.epoch})
        save_weights(self.run / LAST, self.learner.average, card)
        if row.get("miou", -1) > state.best:
            state.best = row["miou"]
            save_weights(self.run / BEST, self.learner.average, card)
        write_log(self.run / LOG, state.rows)
        draw_curve(self.run / CURVE, state.rows)
        picture = self.draw(self.run / SAMPLES / f"epoch-{state.epoch:03d}.png", self._network())
        self.events.add(row, picture)
        save_checkpoint(self.run / CHECKPOINT, self.learner, state)

    def _network(self) -> Network:
        module = self.learner.average.eval()
        return Network(module, self.card, self.card.sensor, self.learner.device)

    def _scores(self) -> Row:
        """Score the validation scans, each by one worker."""
        group, space = self.learner.group, self.card.space
        # On CPUs the workers' statistics of batch norm differ; kept are those of the main one.
        group.broadcast(self.learner.average.buffers())
        own = validate(self._network(), self.validation[group.rank :: group.size])
        counts = group.sum(torch.from_numpy(own.matrix).to(self.learner.device))
        result = scores(Confusion(space.class_count, counts.cpu().numpy()), space)
        if not result.points:
            found = "no point of the validation scans is of a class that counts"
            where = self.validation[0].label_path.parent
            raise TrainingError(where, found, f"labels of {space.name}")
        names = {f"iou_{score.name}": score.iou for score in result.classes}
        return {"miou": result.iou_mean_present} | names

    def _tell(self, state: TrainingState, step: int, loss: float, row: Row | None = None) -> None:
        if not self.learner.group.is_main:
            return
        epoch = state.epoch + (row is None)
        epochs = self.learner.recipe.epochs
        self.report(Report(epoch, epochs, step + 1, self.plan.steps, loss, row))
