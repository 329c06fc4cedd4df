# SPDX-License-Identifier: MIT
"""Scans in memory, as samples on a device take them, and random numbers of batches."""

from collections.abc import Sequence

import numpy as np
import torch
from scans import write_bin

from salsanext_cli import Scan
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats.kitti import read_bin
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.data.dataset import Samples
from salsanext_cli.training.data.on_device.batch_maker import BatchMaker
from salsanext_cli.training.data.on_device.batch_random import BatchRandom
from salsanext_cli.training.data.on_device.point_batch import StoredScan
from salsanext_cli.training.data.on_device.scan_memory import ScanMemory
from salsanext_cli.training.data.on_device.scan_store import ScanStore, half_values
from salsanext_cli.training.data.targets import target_mask

CPU = torch.device("cpu")


def stored(scan: Scan, targets: TrainIds | None = None) -> StoredScan:
    """Return a scan in memory; by default its targets count its points."""
    if targets is None:
        targets = (np.arange(len(scan)) % 256).astype(np.uint8)
    return StoredScan(values=torch.from_numpy(half_values(scan)), targets=torch.from_numpy(targets))


def batch_random(seed: int = 0, device: torch.device = CPU) -> BatchRandom:
    return BatchRandom.seeded([seed], device)


def round_to_half(files: Sequence[ScanFile]) -> None:
    """Replace scans by ones whose values float16 has, so that memory does not change them."""
    for file in files:
        values = half_values(read_bin(file.path)).astype(np.float32)
        write_bin(file.path, Scan(np.ascontiguousarray(values[:, :3]), values[:, 3].copy()))


def maker_of(samples: Samples, device: torch.device = CPU) -> BatchMaker:
    """Return what makes batches of samples, with their scans in memory."""
    store = ScanStore(
        memory=ScanMemory(device=device),
        sets=samples.sets,
        rare=target_mask(samples.rare, samples.sets, np.all),
    )
    return BatchMaker(samples=samples, store=store, keys=store.read(samples.sources), device=device)


def with_statistics(sensor: Sensor, files: Sequence[ScanFile]) -> Sensor:
    """Return a sensor with intensity and gaps of scans, as a training has it."""
    from salsanext_cli import project
    from salsanext_cli.core.geometry.network_input import with_image_statistics

    images = [project(read_bin(file.path), sensor).channels for file in files]
    return with_image_statistics(sensor, images)
