# SPDX-License-Identifier: MIT
"""Samples of a training per CPU second: as worker processes make them, and as a device does.

Both make the same batches of the same scans in this process, in turns. Workers read the scans of
every batch; a device has read them before.

Run: python -m benchmarks.speed.sample_speed DATASET [--recipe paper] [--sensor hdl64] [--turns 5]
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.sensors import sensor
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.training.data.class_counts import count_classes, rare_classes
from salsanext_cli.training.data.dataset import SampleKey, Samples
from salsanext_cli.training.data.on_device.batch_maker import BatchMaker
from salsanext_cli.training.data.on_device.scan_memory import ScanMemory
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.data.sources import Source, training_sources
from salsanext_cli.training.recipe import recipe

CPU = torch.device("cpu")


def samples_of(options: argparse.Namespace) -> Samples:
    """Return the samples of a recipe from all labelled scans of a data set."""
    space = label_space()
    files = [file for file in find_scans(options.dataset) if file.label_path.is_file()]
    source = Source(files=files, space=space, sensor=sensor(options.sensor))
    (fitted,) = training_sources([source], fit=False)
    counts = count_classes(fitted).points.sum(axis=0)
    return Samples(
        sources=[fitted],
        sensor=fitted.sensor,
        recipe=recipe(options.recipe).with_changes(batch=options.batch),
        rare=rare_classes(counts, space.scored),
    )


def maker_of(samples: Samples) -> BatchMaker:
    """Return what makes batches as a device does, with the scans in memory."""
    store = ScanStore(memory=ScanMemory(device=CPU), rare=samples.rare)
    return BatchMaker(samples=samples, store=store, keys=store.read(samples.sources), device=CPU)


def main(*words: str) -> None:
    parser = argparse.ArgumentParser(description="Samples per CPU second, by where they are made.")
    parser.add_argument("dataset", type=Path, help="SemanticKITTI's layout; every labelled scan")
    parser.add_argument("--recipe", default="paper")
    parser.add_argument("--sensor", default="hdl64")
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--turns", type=int, default=5)
    options = parser.parse_args(words or None)
    samples = samples_of(options)
    maker = maker_of(samples)

    def by_workers(keys: list[SampleKey]) -> object:
        return [samples[key] for key in keys]

    makers: dict[str, Callable[[list[SampleKey]], object]] = {
        "workers": by_workers,
        "device": maker.make,
    }
    seconds: dict[str, list[float]] = {kind: [] for kind in makers}
    batches = samples.plan.batches()
    for _ in range(1 + options.turns):
        keys = next(batches)
        for kind, make in makers.items():
            start = time.process_time()
            make(keys)
            seconds[kind].append((time.process_time() - start) / len(keys))
    for kind, times in seconds.items():
        rate = 1 / statistics.median(times[1:])
        print(f"{kind:8} {rate:6.1f} samples per CPU second ({1e3 / rate:.1f} ms each)")
    ratio = np.median(seconds["workers"][1:]) / np.median(seconds["device"][1:])
    print(f"the code of a device is {ratio:.2f} × as fast on this CPU")


if __name__ == "__main__":
    main()
