# SPDX-License-Identifier: MIT
"""All scans of a large training in the memory of a GPU: how fast it fills, and batches from it.

SemanticKITTI has 19 130 scans to train on, 23 GB. Links to a few simulated scans stand for them.
"""

import os
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path

import torch

from benchmarks.gpu.gpu_measures import Figures
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data.dataset import Samples
from salsanext_cli.training.data.on_device.device_batches import DeviceBatches
from salsanext_cli.training.data.on_device.scan_memory import BYTES_PER_POINT, ScanMemory
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.memory import memory_of

SCANS = 19_130  # Of the training of SemanticKITTI
TRIED_SCANS = 64  # By whose time the number of scans is chosen
SHARE_OF_TIME = 0.5  # Largest share of the time that is left for reading
SHARE_OF_MEMORY = 0.6  # Largest share of the memory of the device for the scans
BATCHES = 12  # That are made from the whole store


def measure_store(figures: Figures, samples: Samples, folder: Path, most: int = SCANS) -> None:
    """Measure how fast scans are read into a store, its size, and batches from all of them.

    Parameters
    ----------
    figures : Figures
        Record of the figures.
    samples : Samples
        Samples of few scans, and their recipe.
    folder : Path
        New folder for the links to these scans.
    most : int
        Number of scans, if time and memory allow it.
    """
    device = torch.device(figures.device)
    source = samples.sources[0]
    store = ScanStore(memory=ScanMemory(device=device), jobs=os.cpu_count() or 1)
    tried = linked(source, folder / "tried", min(TRIED_SCANS, most))
    begun = time.monotonic()
    keys = store.read([tried])
    seconds_per_scan = (time.monotonic() - begun) / len(keys)
    points = sum(len(store.whole[key]) for key in keys) / len(keys)
    memory = memory_of(str(device))
    in_memory = most if memory is None else SHARE_OF_MEMORY * memory.available / bytes_of(points)
    in_time = SHARE_OF_TIME * figures.left() / seconds_per_scan
    count = int(min(most, in_memory, in_time))
    if count < len(keys):
        figures.add(f"store of {most} scans", f"skipped: {count} fit")
        return
    whole = linked(source, folder / "whole", count)
    store = ScanStore(memory=ScanMemory(device=device), jobs=os.cpu_count() or 1)
    begun = time.monotonic()
    keys = store.read([whole])
    name = f"store of {count} of {most} scans"
    figures.add(f"{name}, read", len(keys) / (time.monotonic() - begun), "scans/s")
    size = sum(bytes_of(len(scan)) for scan in store.whole.values())
    figures.add(f"{name}, size", size / 1e9, f"GB of {device}")
    measure_batches(figures, name, replace(samples, sources=[whole]), store)


def bytes_of(points: float) -> float:
    """Return the memory of so many points in bytes."""
    return BYTES_PER_POINT * points


def linked(source: Source, folder: Path, count: int) -> Source:
    """Return a source of so many links to the scans of another, of the same names of sequences."""
    files = []
    for number in range(count):
        file = source.files[number % len(source.files)]
        scan = folder / "sequences" / file.sequence / "velodyne" / f"{number:06}{file.path.suffix}"
        links = ScanFile(sequence=file.sequence, stem=scan.stem, path=scan)
        for target, link in ((file.path, links.path), (file.label_path, links.label_path)):
            link.parent.mkdir(parents=True, exist_ok=True)
            os.link(target, link)
        files.append(links)
    return replace(source, files=files)


def measure_batches(figures: Figures, name: str, samples: Samples, store: ScanStore) -> None:
    """Measure the images a second that the device makes from all scans."""
    device = torch.device(figures.device)
    stream = DeviceBatches(samples=samples, store=store, device=device).batches(0)
    images = len(next(stream)[0])
    figures.wait()
    begun = time.monotonic()
    made = 0
    for _ in islice(stream, BATCHES):
        made += images
        if not figures.left() > 0:
            break
    figures.wait()
    figures.add(f"{name}, batches", made / (time.monotonic() - begun), "images/s")
