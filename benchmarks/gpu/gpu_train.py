# SPDX-License-Identifier: MIT
"""Training of given weights in a number of minutes, on scenes that are simulated meanwhile.

The learning rate follows the clock: it is zero when the minutes are over. Every minute the weights
are scored and written, so that a run that is killed leaves those of its last minute:
``last.safetensors`` is the running average, with which scans are labelled, ``module.safetensors``
what a further training begins with. The state of the optimiser is not written: it is larger than
what the machine sends back.
"""

import math
import os
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from multiprocessing.process import BaseProcess
from pathlib import Path

import torch

from benchmarks.gpu.gpu_measures import Figures
from benchmarks.gpu.gpu_training import STEPS, small_weights, street_recipe
from benchmarks.gpu.gpu_use import mean_text, utilisation
from benchmarks.weights.default_weights import (
    LABEL_SPACES,
    SIMULATED,
    compose_circles,
    split_pandaset,
)
from benchmarks.weights.pack import unpack
from benchmarks.weights.scene_pool import KINDS, VALIDATION, ScenePool
from salsanext_cli.commands.line.values.recipe_changes import read_overrides
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.json_files import write_json
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.loading import network_of_module
from salsanext_cli.io.weights.weights import save_weights
from salsanext_cli.runs.results.paths import ScanFile, find_scans
from salsanext_cli.training.data.class_counts import class_counts, class_weights, rare_classes
from salsanext_cli.training.data.dataset import Batch, Samples, batches
from salsanext_cli.training.data.sources import Source, fitted_source
from salsanext_cli.training.data.targets import class_sets
from salsanext_cli.training.initial_network import initial_network
from salsanext_cli.training.learner import Learner, learning_rate
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.run_folder import CLASS_COUNTS, LAST, LOG, Row, write_log
from salsanext_cli.training.scoring.validation import validate

MODULE, SCORES = "module.safetensors", "scores.json"
CHANGES = {"batch": 32, "warm_up": 0.05, "crop_width": 0}
"""Changes of the recipe `street`, whose small batches of windows would leave a GPU idle."""
PLANNED = 1 << 20  # Scans of each kind of sensor, more than any run simulates
SCENES_TO_BEGIN = 16  # Of each kind of sensor
SHARE_BEFORE = 0.3  # Largest share of the time in which scenes are made and nothing is trained
COUNTED_SCANS = 32  # Scans of each kind whose points of each class are counted
SAVE_INTERVAL_S = 60.0
LOGGED_LOSSES = 200  # Steps of which the log has the mean loss
CHECKED_STEPS = 20  # Steps between two looks at the losses
POLL_INTERVAL_S = 0.2
SECONDS_OF_SMALL = 15.0
"""Time that a small training takes at most, however many minutes the run has."""
DESCRIPTION = "Trained with benchmarks/gpu/gpu_run.py on simulated scenes{also}, from {weights}."


@dataclass
class Run:
    """Training in progress, what it has logged, and the folders that it fills."""

    folder: Path  # Working folder
    out: Path  # Copies of all files of the working folder, each whole at any time
    figures: Figures
    learner: Learner
    card: WeightsCard
    held_out: dict[str, Source]  # By name
    rows: list[Row] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    unchecked: list[torch.Tensor] = field(default_factory=list)  # Losses of the last steps
    steps: int = 0
    waited_s: float = 0.0  # For batches

    def fit(self, stream: Iterator[Batch], end: float) -> None:
        """Train until a time, by `time.monotonic`, with a learning rate that is zero then."""
        start = now = saved = time.monotonic()
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
                now = saved = time.monotonic()
        self.save(max(step, 0))

    def check(self) -> None:
        """Read the losses since the last check, which waits for the GPU; some must be finite."""
        values = torch.stack(self.unchecked).tolist() if self.unchecked else []
        finite = [value for value in values if math.isfinite(value)]
        if len(values) == CHECKED_STEPS and not finite:
            found = f"{CHECKED_STEPS} steps in a row without a finite loss"
            raise TrainingError("training", found)
        self.losses += finite
        self.unchecked.clear()

    def save(self, step: int) -> None:
        """Score and write the weights, and write the log."""
        self.check()
        module, recipe = self.learner.average.eval(), self.learner.recipe
        network = network_of_module(module, self.card, self.figures.device)
        scores = {name: validate(network, source)[0] for name, source in self.held_out.items()}
        recent = self.losses[-LOGGED_LOSSES:]
        row: Row = {
            "steps": self.steps,
            "seconds_left": self.figures.left(),
            "learning_rate": learning_rate(recipe, step, STEPS),
            "loss": statistics.fmean(recent) if recent else math.nan,
        }
        for name, scored in scores.items():
            row |= {f"{name}_{key}": scored[key] for key in ("accuracy", "miou")}
            text = f"{scored['accuracy']:.1%} / {scored['miou']:.1%}"
            self.figures.add(f"{name}, accuracy / mean IoU, step {self.steps}", text)
        self.rows.append(row)
        write_log(self.folder / LOG, self.rows)
        numbers = {name: {key: n for key, n in s.items() if n == n} for name, s in scores.items()}
        write_json(self.folder / SCORES, {"steps": self.steps, "scores": numbers})
        if self.steps:
            save_weights(self.folder / LAST, module, self.card, half=True)
            save_weights(self.folder / MODULE, self.learner.module, self.card, half=True)
        for path in self.folder.iterdir():
            if path.is_file():
                write_bytes(self.out / path.name, path.read_bytes())


def train(
    figures: Figures,
    out: Path,
    scratch: Path,
    weights: Path,
    *,
    seed: int = 0,
    pack: Path | None = None,
    changes: Sequence[str] = (),
    small: bool = False,
) -> None:
    """Train weights until the figures' deadline, which includes all that comes before."""
    start, device, cores = time.monotonic(), torch.device(figures.device), os.cpu_count() or 1
    own = CHANGES | ({"batch": 2} if small else {}) | read_overrides(changes)
    recipe = street_recipe(device, **own)
    weights = small_weights(scratch / "small.safetensors", weights) if small else weights
    sensor = read_card(weights).sensor
    module, card = initial_network(weights, label_space(), recipe, sensor)
    numbers = {"scans": 2, "validation": 1} if small else {}
    pool = ScenePool(scratch / "scenes", sensor, seed, **numbers)
    # Processes that start from here on have one thread each.
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"))
    loaders = 0 if small else max(1, cores // 2)
    # Oversubscribed cores would delay this process, which feeds the GPU.
    with pool.working(max(1, cores - loaders - 1)) as makers:
        real, held_out = real_data(pack, scratch / "real", sensor, cores)
        figures.add("real scans are ready after", time.monotonic() - start, "s")
        patience = start + SHARE_BEFORE * figures.left()
        wait_for_scenes(pool, makers, 1 if small else SCENES_TO_BEGIN, patience)
        figures.add("first scenes are ready after", time.monotonic() - start, "s")
        held_out = {VALIDATION: pool.source(VALIDATION), **held_out}
        also = " and real scans" if real else ""
        name = f"{weights.name} (SHA-256 {fingerprint(weights)[:16]})"
        card = replace(
            card,
            recipe=recipe.to_dict() | {"initial": name},
            description=DESCRIPTION.format(also=also, weights=name),
            version=None,
        )
        run = Run(scratch / "run", out, figures, None, card, held_out)  # type: ignore[arg-type]
        samples = begin(run, module, recipe, pool, real, cores)
        before = time.monotonic()
        figures.add("training is ready after", before - start, "s")
        run.save(0)
        reserve_s = 1.5 * (time.monotonic() - before) + 1
        stream = batches(samples, 0, loaders, pinned=device.type == "cuda")
        begun = time.monotonic()
        with utilisation(figures.device) as used:
            end = figures.deadline - reserve_s
            run.fit(stream, min(end, begun + SECONDS_OF_SMALL) if small else end)
        if not run.steps:
            raise TrainingError("training", "no time was left for a step", hint="more --minutes")
        seconds = time.monotonic() - begun
        scenes = {kind: pool.count(kind) for kind in KINDS}
    figures.add("steps", run.steps, f"of {recipe.batch} images in {seconds:.0f} s")
    figures.add("images trained on", run.steps * recipe.batch / seconds, "images/s")
    figures.add("waiting for batches", 100 * run.waited_s / seconds, "% of the time")
    figures.add("GPU used", mean_text(used), "%")
    figures.add(SIMULATED, sum(scenes.values()), str(scenes))
    figures.add("learning rate at the end", run.rows[-1]["learning_rate"])


def real_data(
    pack: Path | None, folder: Path, sensor: Sensor, jobs: int
) -> tuple[list[Source], dict[str, Source]]:
    """Return packed real scans to train on, and those that are held out, as `real_sources` does."""
    roots = {root.name: root for root in unpack(pack, folder)} if pack else {}
    return real_sources(roots, folder, sensor, jobs)


def real_sources(
    roots: Mapping[str, Path], folder: Path, sensor: Sensor, jobs: int
) -> tuple[list[Source], dict[str, Source]]:
    """Return real scans to train on, of data sets by name, and those that are held out, by name.

    The scans of PandaSet's two sensors are one source. The same scans are held out as for the
    default weights.
    """
    if unknown := sorted(roots.keys() - LABEL_SPACES.keys()):
        found = f"are {', '.join(unknown)}"
        raise TrainingError("real scans", found, f"some of {', '.join(LABEL_SPACES)}")
    sources: list[Source] = []
    held_out: dict[str, Source] = {}
    if "pandaset" in roots:
        scans = {name: find_scans(root) for name, root in roots.items() if name != "aachen"}
        training, late = split_pandaset(scans)
        files = sorted(chain(training, *late.values()))
        whole = fitted_source(source_of(files, "pandaset", sensor), jobs)
        sources.append(replace(whole, files=training))
        held_out = {name: replace(whole, files=files) for name, files in late.items()}
    elif "pandargt" in roots:
        raise TrainingError("real scans", "are pandargt without pandaset", "both")
    if "aachen" in roots:
        compose_circles(roots["aachen"], folder / "circles")
        circles = source_of(find_scans(folder / "circles"), "aachen", sensor)
        sources.append(fitted_source(circles, jobs))
    return sources, held_out


def source_of(files: Sequence[ScanFile], name: str, sensor: Sensor) -> Source:
    """Return files as a source with the label space of a packed data set."""
    return Source(files=files, space=label_space(LABEL_SPACES[name]), sensor=sensor)


def wait_for_scenes(
    pool: ScenePool, makers: Sequence[BaseProcess], wanted: int, patience: float
) -> None:
    """Wait for scenes of each kind; after a time, until there is one of each."""
    while True:
        counts = {name: pool.count(name) for name in (*KINDS, VALIDATION)}
        complete = counts.pop(VALIDATION) == pool.validation
        fewest = min(counts.values()) if complete else 0
        if fewest >= wanted or (fewest and time.monotonic() > patience):
            return
        if not any(maker.is_alive() for maker in makers):
            raise TrainingError("scenes", "all processes that simulate them have ended")
        time.sleep(POLL_INTERVAL_S)


def begin(
    run: Run,
    module: SegmentationNetwork,
    recipe: Recipe,
    pool: ScenePool,
    real: list[Source],
    jobs: int,
) -> Samples:
    """Give the run its learner and a card that knows the scans, and return its samples."""
    validation, path = run.held_out[VALIDATION], run.folder / CLASS_COUNTS
    data = training_data(path, pool, real, validation, recipe, run.card, jobs)
    device = torch.device(run.figures.device)
    run.learner = Learner(module, recipe, data.weights, device, sets=data.samples.sets)
    run.card = replace(run.card, trained_on=run.card.trained_on | data.digests)
    return data.samples


@dataclass(frozen=True)
class TrainingData:
    """Samples of a training on scenes that are made meanwhile, and what its scans determine."""

    samples: Samples
    weights: torch.Tensor  # (C,) float32: of the classes in the loss
    digests: frozenset[str]  # Of the real scans


def training_data(
    path: Path,
    pool: ScenePool,
    real: Sequence[Source],
    validation: Source,
    recipe: Recipe,
    card: WeightsCard,
    jobs: int,
) -> TrainingData:
    """Count the points of each class in the first scenes and all real scans, into a file."""
    scenes = [pool.source(kind) for kind in KINDS]
    first = [replace(source, files=source.files[:COUNTED_SCANS]) for source in scenes]
    counted = [*first, *real]
    counts = class_counts(path, counted, validation, validation.files, jobs, recipe.also)
    sources = [*(pool.source(kind, PLANNED) for kind in KINDS), *real]
    of_class, sets = (counts.points, card.space.scored), class_sets(s.space for s in sources)
    return TrainingData(
        samples=Samples(
            sources=sources,
            sensor=card.sensor,
            recipe=recipe,
            rare=rare_classes(*of_class),
            sets=sets,
        ),
        weights=class_weights(*of_class, recipe.class_weight),
        digests=frozenset(counts.digests[file] for source in real for file in source.files),
    )
