# SPDX-License-Identifier: MIT
"""Training whose learning rate follows the clock, with scores and weights of every minute."""

import math
import statistics
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import torch

from benchmarks.gpu.gpu_measures import Figures
from benchmarks.gpu.gpu_training import STEPS
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.json_files import write_json
from salsanext_cli.io.weights.weights import save_weights
from salsanext_cli.training.data.dataset import Batch
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.learner import Learner, learning_rate
from salsanext_cli.training.run_folder import LAST, LOG, Row, write_log
from salsanext_cli.training.scoring.validation import validate

MODULE = "module.safetensors"
SCORES = "scores.json"
SAVE_INTERVAL_S = 60.0
LOGGED_LOSSES = 200  # Steps of which the log has the mean loss
CHECKED_STEPS = 20  # Steps between two looks at the losses


@dataclass(kw_only=True)
class TimedTraining:
    """Training in progress, what it has logged, and the folders that it fills.

    Attributes
    ----------
    folder : Path
        Working folder.
    out : Path
        Folder with copies of all files of the working folder, each whole at any time.
    figures : Figures
        Record of the figures.
    learner : Learner
        Network and optimiser.
    card : WeightsCard
        Card of the weights that are written.
    held_out : mapping of Source
        Scans to validate on, by name.
    rows : list of Row
        Lines of the log.
    losses : list of float
        Finite losses.
    unchecked : list of Tensor
        Losses of the last steps.
    steps : int
        Number of steps so far.
    waited_s : float
        Time spent waiting for batches, in seconds.
    """

    folder: Path
    out: Path
    figures: Figures
    learner: Learner
    card: WeightsCard
    held_out: Mapping[str, Source]
    rows: list[Row] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    unchecked: list[torch.Tensor] = field(default_factory=list)
    steps: int = 0
    waited_s: float = 0.0

    def fit(self, stream: Iterator[Batch], end: float) -> None:
        """Train until a time, by `time.monotonic`, with a learning rate that is zero then."""
        start = time.monotonic()
        now = start
        saved = start
        step = -1
        while now < end:
            images, truth = next(stream)
            self.waited_s += time.monotonic() - now
            # The number of the step is the share of the time that has passed.
            share = (time.monotonic() - start) / (end - start)
            step = max(step + 1, min(int(share * STEPS), STEPS - 1))
            self.unchecked.append(self.learner.step(images, truth, step, STEPS))
            self.steps += 1
            if len(self.unchecked) == CHECKED_STEPS:
                self.check()
            now = time.monotonic()
            if now - saved > SAVE_INTERVAL_S and end - now > SAVE_INTERVAL_S / 2:
                self.save(step)
                now = time.monotonic()
                saved = now
        self.save(max(step, 0))

    def check(self) -> None:
        """Read the losses since the last check, which waits for the GPU; some must be finite."""
        values = torch.stack(self.unchecked).tolist() if self.unchecked else []
        finite = [value for value in values if math.isfinite(value)]
        if len(values) == CHECKED_STEPS and not finite:
            problem = f"{CHECKED_STEPS} steps in a row without a finite loss"
            raise TrainingError("training", problem)
        self.losses += finite
        self.unchecked.clear()

    def save(self, step: int) -> None:
        """Score and write the weights, write the log, and copy all files."""
        self.check()
        scores = self._scores()
        self.rows.append(self._row(step, scores))
        write_log(self.folder / LOG, self.rows)
        numbers = {
            name: {key: n for key, n in row.items() if n == n} for name, row in scores.items()
        }
        write_json(self.folder / SCORES, {"steps": self.steps, "scores": numbers})
        if self.steps:
            save_weights(self.folder / LAST, self.learner.average, self.card, half=True)
            save_weights(self.folder / MODULE, self.learner.module, self.card, half=True)
        for path in self.folder.iterdir():
            if path.is_file():
                write_bytes(self.out / path.name, path.read_bytes())

    def _scores(self) -> dict[str, Row]:
        """Return the scores on the scans that are held out, by name, and print them."""
        network = self.learner.network(self.card)
        scores = {}
        for name, source in self.held_out.items():
            row, _ = validate(network, source)
            text = f"{row['accuracy']:.1%} / {row['miou']:.1%}"
            self.figures.add(f"{name}, accuracy / mean IoU, step {self.steps}", text)
            scores[name] = row
        return scores

    def _row(self, step: int, scores: Mapping[str, Row]) -> Row:
        """Return the line of the log after a step."""
        recent = self.losses[-LOGGED_LOSSES:]
        row: Row = {
            "steps": self.steps,
            "seconds_left": self.figures.left(),
            "learning_rate": learning_rate(self.learner.recipe, step, STEPS),
            "loss": statistics.fmean(recent) if recent else math.nan,
        }
        for name, scored in scores.items():
            row |= {f"{name}_{key}": scored[key] for key in ("accuracy", "miou")}
        return row
