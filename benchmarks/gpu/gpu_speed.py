# SPDX-License-Identifier: MIT
"""Speed of the toolkit on a GPU, beside the method written plainly in torch on the same GPU."""

import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import torch

from benchmarks.finished_scans import FinishedScans
from benchmarks.gpu.gpu_measures import Figures, utilisation
from benchmarks.gpu.gpu_points import measure_points
from benchmarks.speed import baseline
from benchmarks.speed import speed_product as product
from benchmarks.weights.scene_pool import KINDS, SPACING_M, write_scene
from salsanext_cli.commands.stages.predict import predict_scans
from salsanext_cli.core.engines.device import choose_precision
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.loading import load_network
from salsanext_cli.runs.loop.run import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings

PARTS = {"network": 20, "predict": 10, "projection": 20, "knn": 20, "uncertainty": 1}
"""Timed calls of each part of the method."""
ENGINE = "torch"  # The baseline is in torch
SAMPLES = 30  # Monte-Carlo passes of a scan
FEWEST = 2  # Passes in a small run
WIDTHS = (512, 2048)
BATCHES = (1, 4, 16)
RUNS = ((None, None), (None, 1), (1, 1), (None, 8), (4, 1), (16, 1))
"""Batch and workers of each run over a folder; None for the default of the command."""
SMALL_RUNS = ((None, None), (None, 1), (4, 1), (None, 2))
SCANS_OF_RUN = 256  # For each worker
WORKERS_BY_DEFAULT = 8  # For which a run has scans whose workers are chosen by measurement
SECONDS_OF_RUN = 12.0  # Least time that is left for a run


def measure(figures: Figures, weights: Path, *, small: bool = False) -> None:
    """Measure the parts of the method, the network alone, and whole runs of `predict`."""
    trained = read_card(weights).sensor
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_scene(folder, 0, KINDS[0], 0, 2 if small else 8, SPACING_M, trained)
        scans = sorted((folder / "sequences/000000/velodyne").iterdir())
        tiny = replace(trained, height=16, width=64)
        sensors = [tiny] if small else [replace(trained, width=width) for width in WIDTHS]
        for sensor in sensors:
            measure_parts(figures, weights, sensor, scans[0], FEWEST if small else SAMPLES)
            measure_network(figures, weights, sensor)
            measure_points(figures, weights, sensor, scans[0])
        if small:
            measure_runs(figures, NetworkSettings(weights, sensor=tiny), scans, SMALL_RUNS, 8)
        else:
            measure_runs(figures, NetworkSettings(weights), scans, RUNS, SCANS_OF_RUN)


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
    for part, repetitions in PARTS.items():
        name = f"{sensor.height}×{sensor.width} {part}"
        if not figures.has_time_for(name):
            continue
        medians = []
        for side, prepare in (("plain", baseline.prepare), ("toolkit", product.prepare)):
            with figures.peak_memory() as peak:
                ms = 1e3 * figures.seconds(prepare(part, scan, task), repetitions)
                if (side, part) == ("plain", "uncertainty"):
                    ms *= passes
                medians.append(ms)
                figures.add(f"{name}, {side}", ms, f"ms{peak()}")
            torch.backends.cudnn.benchmark = tuned  # The baseline sets it
        figures.add(f"{name}, times as fast", medians[0] / medians[1])


def measure_network(figures: Figures, weights: Path, sensor: Sensor) -> None:
    """Measure the network alone on images that are on the device, by precision and batch."""
    precisions = ("float32",) if figures.device == "cpu" else ("float32", "float16", "bfloat16")
    for precision in precisions:
        network = load_network(weights, figures.device, sensor, precision, ENGINE)
        for batch in BATCHES:
            name = f"{sensor.height}×{sensor.width} network alone, {precision}, batch {batch}"
            if not figures.has_time_for(name):
                return
            images = torch.randn(batch, 5, sensor.height, sensor.width, device=figures.device)
            images = images.to(memory_format=torch.channels_last)
            with torch.inference_mode(), figures.peak_memory() as peak:
                module = cast(TorchBackend, network.backend).torch_module
                seconds = figures.seconds(forward(module, images), 10)
                figures.add(name, 1e3 * seconds / batch, f"ms a scan{peak()}")


def forward(module: torch.nn.Module, images: torch.Tensor) -> Callable[[], object]:
    """Return what computes a module once."""
    return lambda: module(images)


def measure_runs(
    figures: Figures,
    network: NetworkSettings,
    scans: list[Path],
    runs: Sequence[tuple[int | None, int | None]],
    count: int,
) -> None:
    """Measure runs of `predict` over a folder, files to labels, in scans a second."""
    settings = replace(network, device=figures.device, precision="auto", engine=ENGINE)
    for batch, jobs in runs:
        name = f"predict, --batch {batch or 'auto'} --jobs {jobs or 'auto'}"
        if not figures.has_time_for(name, SECONDS_OF_RUN):
            continue
        folder = scans[0].parents[1] / f"copies-{batch}-{jobs}"
        folder.mkdir()
        for number in range(count * (jobs or WORKERS_BY_DEFAULT)):
            os.link(scans[number % len(scans)], folder / f"{number:06}.bin")
        finished = FinishedScans(time.monotonic)
        options = RunOptions(jobs=jobs, progress=finished)
        with tempfile.TemporaryDirectory() as out, utilisation(figures.device) as used:
            start = time.monotonic()
            result = predict_scans(
                folder, Path(out), settings=settings, batch=batch, options=options
            )
            elapsed = time.monotonic() - start
        if result.failures:
            raise RuntimeError(f"{name}: {result.failures[0].reason}")
        times = finished.readings
        share = f", GPU {statistics.fmean(used):.0f} %" if used else ""
        figures.add(f"{name}, with its start", len(times) / elapsed, f"scans/s{share}")
        warm = len(times) // 4  # Whole batches, which pay for loading the network
        rate = (len(times) - warm) / max(times[-1] - times[warm - 1], 1e-9)
        figures.add(f"{name}, the later scans", rate, "scans/s")
