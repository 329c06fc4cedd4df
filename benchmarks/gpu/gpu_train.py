# SPDX-License-Identifier: MIT
"""Training of given weights in a number of minutes, on scenes that are simulated meanwhile.

The learning rate follows the clock: it is zero when the minutes are over. Every minute the weights
are scored and written, so that a run that is killed leaves those of its last minute:
``last.safetensors`` is the running average, with which scans are labelled, ``module.safetensors``
what a further training begins with. The state of the optimiser is not written: it is larger than
what the machine sends back.
"""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import torch

from benchmarks.gpu.gpu_measures import Figures
from benchmarks.gpu.gpu_timed_training import TimedTraining
from benchmarks.gpu.gpu_train_data import RealScans, TrainingData, packed_scans, training_data
from benchmarks.gpu.gpu_training import small_weights, street_recipe
from benchmarks.gpu.gpu_use import mean_text, utilisation
from benchmarks.weights.default_weights import SIMULATED
from benchmarks.weights.scene_pool import KINDS, VALIDATION, ScenePool
from salsanext_cli.commands.line.values.recipe_changes import read_overrides
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.training.data.dataset import batches
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import CLASS_COUNTS

CHANGES = {"batch": 32, "warm_up": 0.05, "crop_width": 0}
"""Changes of the recipe `street`, whose small batches of windows would leave a GPU idle."""
SCENES_TO_BEGIN = 16  # Of each kind of sensor
SHARE_BEFORE = 0.3  # Largest share of the time in which scenes are made and nothing is trained
POLL_INTERVAL_S = 0.2
SECONDS_OF_SMALL = 15.0
"""Time that a small training takes at most, however many minutes the run has."""
DESCRIPTION = "Trained with benchmarks/gpu/gpu_run.py on simulated scenes{also}, from {weights}."


@dataclass(frozen=True, kw_only=True)
class TrainRequest:
    """What is trained, and where its files go.

    Attributes
    ----------
    out : Path
        Folder of the results.
    scratch : Path
        Working folder.
    weights : Path
        Weights to begin with.
    seed : int
        Seed of the simulated scenes.
    pack : Path, optional
        Packed real scans.
    changes : sequence of str
        Changes of the recipe, as key=value.
    small : bool
        Whether the images are tiny, to check the script.
    """

    out: Path
    scratch: Path
    weights: Path
    seed: int = 0
    pack: Path | None = None
    changes: Sequence[str] = ()
    small: bool = False


@dataclass(frozen=True, kw_only=True)
class Start:
    """What a training begins with."""

    recipe: Recipe
    weights: Path
    module: SegmentationNetwork
    card: WeightsCard

    def learner(self, data: TrainingData, device: str) -> Learner:
        """Return what learns from samples on a device."""
        sets = data.samples.sets
        return Learner(self.module, self.recipe, data.weights, torch.device(device), sets=sets)


@dataclass(frozen=True, kw_only=True)
class Cores:
    """Processes that feed a training, besides the one that trains.

    Oversubscribed cores would delay the process that feeds the GPU.
    """

    all: int
    loaders: int

    @property
    def makers(self) -> int:
        """Processes that simulate scenes."""
        return max(1, self.all - self.loaders - 1)


def train(figures: Figures, request: TrainRequest) -> None:
    """Train weights until the figures' deadline, which includes all that comes before."""
    begun = time.monotonic()
    count = os.cpu_count() or 1
    cores = Cores(all=count, loaders=0 if request.small else max(1, count // 2))
    start = start_of(torch.device(figures.device), request)
    sensor = start.card.sensor
    sizes = {"scans": 2, "validation": 1} if request.small else {}
    pool = ScenePool(request.scratch / "scenes", sensor, request.seed, **sizes)
    # Processes that start from here on have one thread each.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))
    with pool.working(cores.makers) as makers:
        real = packed_scans(request.pack, request.scratch / "real", sensor, cores.all)
        figures.add("real scans are ready after", time.monotonic() - begun, "s")
        patience = begun + SHARE_BEFORE * figures.left()
        wait_for_scenes(pool, makers, 1 if request.small else SCENES_TO_BEGIN, patience)
        figures.add("first scenes are ready after", time.monotonic() - begun, "s")
        folder = request.scratch / "run"
        validation = pool.source(VALIDATION)
        data = training_data(
            folder / CLASS_COUNTS,
            pool,
            real.training,
            validation,
            start.recipe,
            start.card,
            cores.all,
        )
        training = TimedTraining(
            folder=folder,
            out=request.out,
            figures=figures,
            learner=start.learner(data, figures.device),
            card=card_of(start, real, data),
            held_out={VALIDATION: validation, **real.held_out},
        )
        figures.add("training is ready after", time.monotonic() - begun, "s")
        fit(training, data, cores.loaders, small=request.small)
        scenes = {kind: pool.count(kind) for kind in KINDS}
    figures.add(SIMULATED, sum(scenes.values()), str(scenes))
    figures.add("learning rate at the end", training.rows[-1]["learning_rate"])


def start_of(device: torch.device, request: TrainRequest) -> Start:
    """Return the recipe of a training, its weights, and the network that they begin."""
    smaller = {"batch": 2} if request.small else {}
    changes: dict[str, Any] = CHANGES | smaller | read_overrides(request.changes)
    recipe = street_recipe(device, **changes)
    weights = request.weights
    if request.small:
        weights = small_weights(request.scratch / "small.safetensors", weights)
    sensor = read_card(weights).sensor
    module, card = initial_network(weights, label_space(), recipe, sensor)
    return Start(recipe=recipe, weights=weights, module=module, card=card)


def card_of(start: Start, real: RealScans, data: TrainingData) -> WeightsCard:
    """Return the card of the trained weights, which knows their recipe and their real scans."""
    name = f"{start.weights.name} (SHA-256 {fingerprint(start.weights)[:16]})"
    also = " and real scans" if real.training else ""
    return replace(
        start.card,
        recipe=start.recipe.to_dict() | {"initial": name},
        description=DESCRIPTION.format(also=also, weights=name),
        version=None,
        trained_on=start.card.trained_on | data.digests,
    )


def wait_for_scenes(
    pool: ScenePool, makers: Sequence[BaseProcess], needed: int, patience: float
) -> None:
    """Wait for scenes of each kind; after a time, until there is one of each."""
    while True:
        counts = {name: pool.count(name) for name in (*KINDS, VALIDATION)}
        is_complete = counts.pop(VALIDATION) == pool.validation
        fewest = min(counts.values()) if is_complete else 0
        if fewest >= needed or (fewest and time.monotonic() > patience):
            return
        if not any(maker.is_alive() for maker in makers):
            raise TrainingError("scenes", "all processes that simulate them have ended")
        time.sleep(POLL_INTERVAL_S)


def fit(training: TimedTraining, data: TrainingData, loaders: int, *, small: bool) -> None:
    """Train until the time of the figures is over, but for a last score; add the speed."""
    figures = training.figures
    before = time.monotonic()
    training.save(0)
    reserve_s = 1.5 * (time.monotonic() - before) + 1
    is_pinned = training.learner.device.type == "cuda"
    stream = batches(data.samples, 0, loaders, pinned=is_pinned)
    begun = time.monotonic()
    end = figures.deadline - reserve_s
    if small:
        end = min(end, begun + SECONDS_OF_SMALL)
    with utilisation(figures.device) as used:
        training.fit(stream, end)
    if not training.steps:
        raise TrainingError("training", "no time was left for a step", hint="more --minutes")
    seconds = time.monotonic() - begun
    images = training.learner.recipe.batch
    figures.add("steps", training.steps, f"of {images} images in {seconds:.0f} s")
    figures.add("images trained on", training.steps * images / seconds, "images/s")
    figures.add("waiting for batches", 100 * training.waited_s / seconds, "% of the time")
    figures.add("GPU used", mean_text(used), "%")
