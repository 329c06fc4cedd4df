# SPDX-License-Identifier: MIT
"""Speed of the toolkit on a GPU, beside the method written plainly in torch on the same GPU.

A measurement that would not end in time is skipped, by the time that a smaller one took.
"""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

import torch

from benchmarks.gpu.gpu_measures import NETWORK, Figures
from benchmarks.gpu.gpu_points import measure_points
from benchmarks.gpu.gpu_predict import SCANS_OF_WORKER, FolderRun, measure_runs
from benchmarks.speed import baseline
from benchmarks.speed import speed_product as product
from benchmarks.weights.scene_pool import KINDS, SPACING_M, write_scene
from salsanext_cli.core.engines.device import choose_precision
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.loading import load_network

PARTS = {"network": 20, "predict": 10, "projection": 20, "knn": 20, "uncertainty": 1}
"""Timed calls of each part of the method."""
PASSES = {"network": 1.0, "predict": 3.0, "projection": 1.0, "knn": 2.0, "uncertainty": 4.0}
"""Passes of the network that take at least as long as a call, to expect its time."""
ENGINE = "torch"  # The baseline is in torch
SAMPLES = 30  # Monte-Carlo passes of a scan
FEWEST = 2  # Passes in a small run, and scans
SCANS = 8  # That are simulated
SECONDS_OF_SCANS = 120.0  # Least time that is left for so many scans
WIDTHS = (512, 2048)
BATCHES = (1, 4, 16)
AS_TYPED = (FolderRun(most_seconds=35.0),)
"""The run of most users, which comes first; workers take 11 s to start."""
RUNS = (
    FolderRun(jobs=1),
    FolderRun(jobs=8),
    FolderRun(batch=1, jobs=1),
    FolderRun(batch=4, jobs=1),
    FolderRun(batch=16, jobs=1),
)
SMALL_RUNS = (FolderRun(jobs=1), FolderRun(batch=4, jobs=1), FolderRun(jobs=2))


def measure(figures: Figures, weights: Path, *, small: bool = False) -> None:
    """Measure whole runs of `predict`, the parts of the method, and the network alone."""
    trained = read_card(weights).sensor
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        count = FEWEST if small or figures.left() < SECONDS_OF_SCANS else SCANS
        write_scene(folder, 0, KINDS[0], 0, count, SPACING_M, trained)
        scans = sorted((folder / "sequences/000000/velodyne").iterdir())
        tiny = replace(trained, height=16, width=64)
        sensors = [tiny] if small else [replace(trained, width=width) for width in WIDTHS]
        scans_of_worker = FEWEST if small else SCANS_OF_WORKER
        passes = FEWEST if small else SAMPLES
        measure_runs(figures, weights, sensors[-1], scans, AS_TYPED, scans_of_worker)
        for sensor in sensors:
            measure_parts(figures, weights, sensor, scans[0], passes)
            measure_points(figures, weights, sensor, scans[0], passes)
        for sensor in sensors[:-1]:
            measure_runs(figures, weights, sensor, scans, AS_TYPED, scans_of_worker)
        for sensor in sensors:
            measure_network(figures, weights, sensor)
        for sensor in sensors:
            runs = SMALL_RUNS if small else RUNS
            measure_runs(figures, weights, sensor, scans, runs, scans_of_worker)


def measure_parts(figures: Figures, weights: Path, sensor: Sensor, scan: Path, passes: int) -> None:
    """Measure each part of the method on both sides, in milliseconds, and its memory in GB."""
    task = {
        "weights": str(weights.resolve()),
        "device": figures.device,
        "precision": choose_precision("auto", figures.device, ENGINE),
        "engine": ENGINE,
        "sensor": sensor.to_dict(),
        "samples": passes,
        "passes": 1,  # Of the baseline's, which are all alike
    }
    tuned = torch.backends.cudnn.benchmark
    pixels = sensor.height * sensor.width
    for part, repetitions in PARTS.items():
        medians = []
        for side, prepare in (("toolkit", product.prepare), ("plain", baseline.prepare)):
            name = f"{sensor.height}×{sensor.width} {part}, {side}"
            kind = f"{part}, {side}"
            expected = PASSES[part] * (passes if kind == "uncertainty, toolkit" else 1)
            if not figures.has_time_for_calls(name, kind, pixels, expected):
                continue
            with figures.peak_memory() as peak:
                call = prepare(part, scan, task)
                ms = 1e3 * figures.seconds_of(kind, pixels, call, repetitions)
                if kind == "uncertainty, plain":
                    ms *= passes
                medians.append(ms)
                figures.add(name, ms, f"ms{peak()}")
            torch.backends.cudnn.benchmark = tuned  # The baseline sets it
            figures.paces.setdefault(NETWORK, figures.paces[kind])
        if len(medians) == 2:
            name = f"{sensor.height}×{sensor.width} {part}, times as fast"
            figures.add(name, medians[1] / medians[0])


def measure_network(figures: Figures, weights: Path, sensor: Sensor) -> None:
    """Measure the network on images that are on the device, by precision and batch.

    Alone, each kernel is launched from Python; as in `predict`, a graph of few pixels is replayed.
    """
    precisions = ("float32",) if figures.device == "cpu" else ("float16", "float32", "bfloat16")
    for precision in precisions:
        network = load_network(weights, figures.device, sensor, precision, ENGINE)
        backend = cast(TorchBackend, network.backend)
        for batch in BATCHES:
            images = torch.randn(batch, 5, sensor.height, sensor.width, device=figures.device)
            images = images.to(memory_format=torch.channels_last)
            calls: dict[str, Callable[[], object]] = {
                "network alone": forward(backend.torch_module, images),
                "network as in predict": partial(backend.softmax, images, 1.0),
            }
            for kind, call in calls.items():
                name = f"{sensor.height}×{sensor.width} {kind}, {precision}, batch {batch}"
                kind_of_precision = f"{kind}, {precision}"
                pixels = images[:, 0].numel()
                if not figures.has_time_for_calls(name, kind_of_precision, pixels):
                    continue
                with torch.inference_mode(), figures.peak_memory() as peak:
                    seconds = figures.seconds_of(kind_of_precision, pixels, call, 10)
                    figures.add(name, 1e3 * seconds / batch, f"ms a scan{peak()}")


def forward(module: torch.nn.Module, images: torch.Tensor) -> Callable[[], object]:
    """Return what computes a module once."""
    return lambda: module(images)
