# SPDX-License-Identifier: MIT
"""Speed of training on a GPU by batch, loaders and samples of the device; parts of a step."""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import torch

from benchmarks.gpu.gpu_measures import Figures
from benchmarks.gpu.gpu_store import SCANS, measure_store
from benchmarks.gpu.gpu_use import mean_text, utilisation
from benchmarks.speed.training_speed import Laps
from benchmarks.weights.scene_pool import KINDS, ScenePool
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.registry import ARCHITECTURES, build
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_weights
from salsanext_cli.training.data.class_counts import class_weights, count_classes, rare_classes
from salsanext_cli.training.data.dataset import Batch, Samples, batches
from salsanext_cli.training.data.on_device.device_batches import DeviceBatches
from salsanext_cli.training.data.on_device.scan_memory import ScanMemory
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import Learner, fastest_precision
from salsanext_cli.training.recipe import Recipe, recipe

WINDOWS = (256, 0)  # Columns of a window, 0 for the full circle
SCENES = 4
STEPS = 100_000
"""Steps of an epoch, more than any run takes."""
REPETITIONS = 8
SECONDS_OF_LOADERS = 4.0
BATCH_OF_LOADERS = 16
BATCH_OF_DEVICE = 24  # That of the paper
PAPER_ALONE = {
    **dict.fromkeys(("rotate", "shift", "flip", "drop"), 0.5),
    **dict.fromkeys(("mix", "paste", "intensity", "no_intensity", "mount"), 0.0),
    **dict.fromkeys(("view", "fewer_beams", "jitter", "holes"), 0.0),
}
"""Chances of the augmentations of the paper, without others."""
DEVICE_SAMPLES: dict[str, dict[str, Any]] = {
    "samples of the device, paper, 64×2048": {"widths": "2048", **PAPER_ALONE},
    "samples of the device, street, 64×2048": {"widths": "2048"},
    "samples of the device, street, 64×512": {},
}
"""Changes of the recipe `street` by name, the most important first."""
SMALL_SAMPLES: dict[str, dict[str, Any]] = {"samples of the device, small": {}}


@dataclass(frozen=True, kw_only=True)
class StepSize:
    """Size of a step: windows of a batch, and columns of a window, 0 for the full circle."""

    batch: int
    width: int


STEP_SIZES = (StepSize(batch=BATCH_OF_DEVICE, width=0), StepSize(batch=32, width=256))
SMALL_STEP_SIZES = (StepSize(batch=2, width=0),)


@dataclass(frozen=True, kw_only=True)
class Training:
    """What learns, and the samples that it learns from."""

    learner: Learner
    samples: Samples


@dataclass(frozen=True, kw_only=True)
class Trainings:
    """Trainings with the recipe `street` on simulated scans.

    Attributes
    ----------
    pool : ScenePool
        The scans.
    weights : Path
        Weights that a training begins with.
    device : torch.device
        Device of the trainings.
    """

    pool: ScenePool
    weights: Path
    device: torch.device

    def started(self, *, batch: int, width: int, **changes: Any) -> Training:
        """Return a training with a batch, a width of windows, and other changes of the recipe."""
        recipe = street_recipe(self.device, batch=batch, crop_width=width, **changes)
        sources = [self.pool.source(kind) for kind in KINDS]
        counts = count_classes(sources[0]).points.sum(axis=0)
        scored = label_space().scored
        module, card = initial_network(self.weights, label_space(), recipe, self.pool.sensor)
        class_weight = class_weights(counts, scored, recipe.class_weight)
        rare = rare_classes(counts, scored)
        return Training(
            learner=Learner(module, recipe, class_weight, self.device),
            samples=Samples(sources=sources, sensor=card.sensor, recipe=recipe, rare=rare),
        )


def measure(figures: Figures, weights: Path, scratch: Path, *, small: bool = False) -> None:
    """Measure samples of the device, a whole store, steps, and loaders alone and beside steps.

    What was never measured comes first, since the time may end before the rest.
    """
    device = torch.device(figures.device)
    weights = small_weights(scratch / "small.safetensors", weights) if small else weights
    sensor = read_card(weights).sensor
    pool = ScenePool(scratch / "training", sensor, scans=2 if small else 8, validation=0)
    for number in range(2 if small else SCENES):
        pool.make(number)
    trainings = Trainings(pool=pool, weights=weights, device=device)
    seconds = 1.0 if small else SECONDS_OF_LOADERS
    batch_of_device = 2 if small else BATCH_OF_DEVICE
    for name, changes in (SMALL_SAMPLES if small else DEVICE_SAMPLES).items():
        if figures.has_time_for(name, 4 * seconds):
            training = trainings.started(batch=batch_of_device, width=0, **changes)
            measure_device_samples(figures, name, training, seconds)
    if figures.has_time_for("store of a whole training", 6 * seconds):
        full_width = {} if small else {"widths": "2048"}
        changes = {**full_width, **PAPER_ALONE}
        training = trainings.started(batch=batch_of_device, width=0, **changes)
        measure_store(figures, training.samples, scratch / "store", 4 if small else SCANS)
    for size in SMALL_STEP_SIZES if small else STEP_SIZES:
        name = f"step on the device, width {size.width or sensor.width}, batch {size.batch}"
        if figures.has_time_for(name, 3):
            training = trainings.started(batch=size.batch, width=size.width)
            measure_steps(figures, name, training)
    cores = os.cpu_count() or 1
    batch_of_loaders = 2 if small else BATCH_OF_LOADERS
    for loaders in (1,) if small else (cores // 4, cores // 2, cores - 2):
        for width in (0,) if small else WINDOWS:
            name = f"{loaders} loaders, width {width or sensor.width}"
            if figures.has_time_for(name, 4 * seconds):
                training = trainings.started(batch=batch_of_loaders, width=width)
                measure_loaders(figures, name, training, loaders, seconds)


def small_weights(path: Path, weights: Path) -> Path:
    """Write random weights of few channels and pixels; salsanext has these in this process now."""
    few: dict[str, Any] = {"context_width": 8, "widths": (8, 16), "decoder_widths": (16,)}
    ARCHITECTURES["salsanext"] = partial(SalsaNext, **few)
    architecture = {"name": "salsanext", "class_count": label_space().class_count, "dropout": 0.1}
    sensor = replace(read_card(weights).sensor, height=16, width=64)
    save_weights(path, build(architecture), WeightsCard(architecture, label_space(), sensor))
    return path


def street_recipe(device: torch.device, **changes: Any) -> Recipe:
    """Return the recipe `street` as one epoch of `STEPS` steps, with some changes."""
    street = recipe("street").with_changes(**changes)
    is_automatic = street.precision == "auto"
    precision = fastest_precision(device) if is_automatic else street.precision
    samples = STEPS * street.batch
    return street.with_changes(epochs=1, samples_per_epoch=samples, precision=precision)


def measure_steps(figures: Figures, name: str, training: Training) -> None:
    """Measure steps on one batch: windows a second, and milliseconds of each part of a step."""
    learner = training.learner
    images, truth = next(batches(training.samples, 0, pinned=figures.device != "cpu"))
    steps = iter(range(STEPS))

    def step() -> None:
        learner.step(images, truth, next(steps), STEPS)

    with figures.peak_memory() as peak:
        seconds = figures.seconds(step, REPETITIONS)
        figures.add(name, len(images) / seconds, f"windows/s{peak()}")
    laps = Laps("wall")

    def lap(part: str) -> Callable[..., None]:
        def end(*_: object) -> None:
            figures.wait()
            laps(part)

        return end

    hooks = [
        learner.module.register_forward_hook(lap("forward")),
        learner.loss.register_forward_hook(lap("loss")),
        learner.optimiser.register_step_pre_hook(lap("backward")),
    ]
    laps.start()
    for _ in range(REPETITIONS):
        step()
        lap("update")()
    for hook in hooks:
        hook.remove()
    parts = ("forward", "loss", "backward", "update")
    text = ", ".join(f"{part} {1e3 * laps.seconds[part] / REPETITIONS:.3g}" for part in parts)
    figures.add("  ms of a step that waits for each part", text)


def measure_loaders(
    figures: Figures, name: str, training: Training, loaders: int, seconds: float
) -> None:
    """Measure windows a second that loaders deliver, and those that are learnt from beside."""
    pinned = figures.device != "cpu"
    stream = batches(training.samples, 0, loaders, pinned=pinned)
    windows = len(next(stream)[0])
    for _ in range(2 * loaders):  # Those that are ready
        next(stream)
    rate = windows * rate_of(figures, stream, seconds, lambda *_: None)
    figures.add(f"{name}, alone", rate, "windows/s")
    with utilisation(figures.device) as used:

        def step(number: int, batch: Batch) -> None:
            training.learner.step(batch[0], batch[1], number, STEPS)

        rate = windows * rate_of(figures, stream, seconds, step)
    figures.add(f"{name}, training", rate, "windows/s")
    figures.add(f"{name}, GPU used", mean_text(used), "%")


def measure_device_samples(figures: Figures, name: str, training: Training, seconds: float) -> None:
    """Measure images a second that the device makes, those that it makes and learns from.

    The last figure is the share of the speed on batches that are ready.
    """
    learner = training.learner
    samples = training.samples
    memory = ScanMemory(device=learner.device)
    store = ScanStore(memory=memory, rare=samples.rare, jobs=os.cpu_count() or 1)
    begun = time.monotonic()
    keys = store.read(samples.sources)
    elapsed = time.monotonic() - begun
    figures.add(f"{name}, scans read", len(keys) / elapsed, "scans/s")
    source = DeviceBatches(samples=samples, store=store, device=learner.device)
    stream = source.batches(0)
    ready = next(stream)
    images = len(ready[0])
    rate = images * rate_of(figures, stream, seconds, lambda *_: None)
    figures.add(f"{name}, alone", rate, "images/s")

    def step(number: int, batch: Batch) -> None:
        learner.step(batch[0], batch[1], number, STEPS)

    step(0, ready)
    on_ready = images * rate_of(figures, repeat(ready), seconds, step)
    figures.add(f"{name}, training on a ready batch", on_ready, "images/s")
    with utilisation(figures.device) as used:
        rate = images * rate_of(figures, stream, seconds, step)
    figures.add(f"{name}, training", rate, "images/s")
    figures.add(f"{name}, share of a ready batch", 100 * rate / on_ready, "%")
    figures.add(f"{name}, GPU used", mean_text(used), "%")


def rate_of(
    figures: Figures, stream: Iterator[Batch], seconds: float, work: Callable[[int, Batch], object]
) -> float:
    """Return batches a second while a function takes them for so many seconds."""
    start, number = time.monotonic(), 0
    while time.monotonic() - start < seconds:
        work(number, next(stream))
        number += 1
    figures.wait()  # A step returns before a GPU has taken it.
    return number / (time.monotonic() - start)
