# SPDX-License-Identifier: MIT
"""Steps per second of `salsanext train` beside those of a loop as published ones are written.

Both have the same network, weights to begin with, scans, recipe and number of threads, and prepare
their samples themselves, without worker processes. Each is a process of its own. They take turns
of a few steps, so that what else the machine does falls on both; printed are the median and the
range of the turns' ratios, and what each part of a step took. First, both must find the same loss
for the same batch.

Run: python -m benchmarks.speed.training_speed DATASET [--sensor hdl64 --batch 2 --width 512 …]
"""

import argparse
import multiprocessing
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.speed.plain_training import PlainTraining
from salsanext_cli.core.engines.device import choose_precision
from salsanext_cli.core.network.registry import build
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.sensors import sensor
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.class_counts import class_weights, count_classes, rare_classes
from salsanext_cli.training.data.dataset import Samples, batches
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe

SIDES = ("plain", "ours")
PARTS = ("data", "forward", "loss", "backward", "update", "book-keeping")
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
SAME = 2e-3
"""Largest relative difference of the two losses of a batch: bfloat16 has eight bits."""


class Laps:
    """Sums of seconds by part of a step."""

    def __init__(self, clock: str) -> None:
        self.clock = CLOCKS[clock]
        self.start()

    def start(self) -> None:
        """Begin anew."""
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.last = self.clock()

    def __call__(self, part: str) -> None:
        """Count what has passed since the last call to a part."""
        now = self.clock()
        self.seconds[part] += now - self.last
        self.last = now


class Comparison:
    """Scans, recipe and weights that both sides have in common."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.space, self.sensor = label_space(), sensor(options.sensor)
        files = [file for file in find_scans(options.dataset) if file.label_path.is_file()]
        shape = {"batch": options.batch, "crop_width": options.width}
        precision = choose_precision(options.precision, "cpu", "torch")
        self.recipe = Recipe(**shape, epochs=1_000_000, precision=precision)
        source = Source(files=files, space=self.space, sensor=self.sensor)
        counts = count_classes(source).points.sum(axis=0)
        rare = rare_classes(counts, self.space.scored)
        self.samples = Samples(sources=[source], sensor=self.sensor, recipe=self.recipe, rare=rare)
        self.weights = class_weights(counts, self.space.scored)
        torch.manual_seed(0)
        numbers = {"class_count": self.space.class_count, "dropout": self.recipe.dropout}
        self.module = build({"name": options.architecture, **numbers}, "--architecture")
        self.laps = Laps(options.clock)

    def stream(self) -> Iterator[tuple[Tensor, Tensor]]:
        """Return the batches as `salsanext train` has them."""
        return batches(self.samples, 0)

    def plain(self) -> tuple[float, Callable[[], object]]:
        """Return the plain loop's loss of the first batch, and what takes a step."""
        loop = PlainTraining(
            *(self.module, self.samples.sources[0].files, self.space, self.sensor),
            *(self.recipe, self.weights, self.laps),
        )
        images, truth = next(self.stream())
        return self.first(
            lambda: loop.loss(loop.module(images).softmax(1), truth.long())
        ), loop.step

    def ours(self) -> tuple[float, Callable[[], object]]:
        """Return the same of our training, whose parts are told by hooks."""
        learner = Learner(self.module, self.recipe, self.weights, torch.device("cpu"))
        images, truth = next(self.stream())
        learner.module.train()

        def of_first() -> Tensor:
            with learner.autocast:
                return learner.loss(learner.module(images.to(memory_format=learner.layout)), truth)

        loss = self.first(of_first)
        learner.module.register_forward_hook(lambda *_: self.laps("forward"))
        learner.loss.register_forward_hook(lambda *_: self.laps("loss"))
        learner.optimiser.register_step_pre_hook(lambda *_: self.laps("backward"))
        stream = enumerate(self.stream())

        def step() -> None:
            number, (images, truth) = next(stream)
            self.laps("data")
            learner.step(images, truth, number, 100)
            self.laps("update")

        return loss, step

    def first(self, loss: Callable[[], Tensor]) -> float:
        """Return a loss, dropout being the same on both sides, without learning from it."""
        before = {name: tensor.clone() for name, tensor in self.module.state_dict().items()}
        torch.manual_seed(0)
        with torch.no_grad():
            found = float(loss())
        self.module.load_state_dict(before)
        return found


def serve(side: str, options: argparse.Namespace, line: Connection) -> None:
    """Send the loss of the first batch, then the seconds of as many steps as are asked for."""
    common = Comparison(options)
    loss, step = getattr(common, side)()
    step()
    line.send(loss)
    while steps := line.recv():
        common.laps.start()
        for _ in range(steps):
            step()
        line.send({part: seconds / steps for part, seconds in common.laps.seconds.items()})


@contextmanager
def served(options: argparse.Namespace) -> Iterator[dict[str, Connection]]:
    """Run both sides, each in its process, and end them."""
    context = multiprocessing.get_context("spawn")
    lines, processes = {}, []
    for side in SIDES:
        lines[side], other = context.Pipe()
        processes.append(context.Process(target=serve, args=(side, options, other), daemon=True))
        processes[-1].start()
        other.close()
    try:
        yield lines
        for line in lines.values():
            line.send(0)
    finally:
        for line in lines.values():
            line.close()
        for process in processes:
            process.join()


def measure(options: argparse.Namespace) -> dict[str, list[dict[str, float]]]:
    """Return the seconds of each part of a step, by side and turn."""
    turns: dict[str, list[dict[str, float]]] = {side: [] for side in SIDES}
    with served(options) as lines:
        plain, ours = (line.recv() for line in lines.values())
        print(f"loss of the same batch: plain {plain:.6f}, ours {ours:.6f}")
        if abs(plain - ours) > SAME * abs(plain):
            raise SystemExit(f"the losses differ by more than {SAME:g} of them: nothing to compare")
        for turn in range(options.turns):
            for side in SIDES if turn % 2 else reversed(SIDES):
                lines[side].send(options.steps)
                turns[side].append(lines[side].recv())
    return turns


def show(turns: dict[str, list[dict[str, float]]]) -> None:
    """Print a table: each part's seconds per step and share, and the ratio of the turns."""
    medians = {
        side: {part: statistics.median(turn[part] for turn in turns[side]) for part in PARTS}
        for side in SIDES
    }
    print(f"{'seconds per step':18}{'plain':>9}{'share':>8}{'ours':>9}{'share':>8}")
    for part in PARTS:
        cells = (
            f"{medians[side][part]:9.3f}{medians[side][part] / sum(medians[side].values()):8.1%}"
            for side in SIDES
        )
        print(f"{part:18}" + "".join(cells))
    wholes = {side: [sum(turn.values()) for turn in turns[side]] for side in SIDES}
    plain, ours = (statistics.median(wholes[side]) for side in SIDES)
    print(f"{'step':18}{plain:9.3f}{'':8}{ours:9.3f}")
    ratios = [p / o for p, o in zip(wholes["plain"], wholes["ours"], strict=True)]
    spread = f"({min(ratios):.2f} to {max(ratios):.2f} over {len(ratios)} turns)"
    print(f"ours is {statistics.median(ratios):.2f} × as fast {spread}")


def main(*words: str) -> None:
    parser = argparse.ArgumentParser(description="How fast training is, beside a plain loop.")
    parser.add_argument("dataset", type=Path, help="SemanticKITTI's layout; every labelled scan")
    parser.add_argument("--sensor", default="hdl64")
    parser.add_argument("--architecture", default="salsanext")
    parser.add_argument("--batch", type=int, default=2)
    parser.add_argument("--width", type=int, default=0, help="of windows; 0 is the full circle")
    parser.add_argument("--precision", default="auto", help="of ours; the plain loop has float32")
    parser.add_argument("--steps", type=int, default=1, help="of a turn")
    parser.add_argument("--turns", type=int, default=5, help="of each side")
    parser.add_argument(
        "--clock",
        choices=CLOCKS,
        default="wall",
        help="cpu counts only what the processor did for us; say OMP_NUM_THREADS=1",
    )
    options = parser.parse_args(words or None)
    threads = torch.get_num_threads()
    print(f"batch {options.batch}, width {options.width or 'full'}, {threads} threads")
    show(measure(options))


if __name__ == "__main__":
    main()
