# SPDX-License-Identifier: MIT
"""Jobs that need a network: each worker loads it once, on a GPU of its own if there are several."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

from salsanext_cli.compiled import thread_count
from salsanext_cli.engines.batches import BatchSize
from salsanext_cli.engines.device import MAX_BATCH_PIXELS, choose_device
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.parallel.job import Computed, Prepared, ScanJob
from salsanext_cli.parallel.pipeline import Pipeline
from salsanext_cli.parallel.worker import own_device

MAX_BATCH_SCANS = 16  # Scans computed together on a GPU, as many as a worker is sent
MAX_READERS = 8  # Threads that prepare scans for a GPU

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class NetworkTask:
    """Job of a network, opened once per worker."""

    max_chunk_scans: ClassVar[int] = MAX_BATCH_SCANS
    job: Callable[[Network], ScanJob[Any, Any, Any]]  # Makes the job; picklable
    settings: NetworkSettings  # Resolved: what the workers load
    # The same, loaded in this process; it is not sent to others
    network: Network | None = field(default=None, compare=False)
    batch: int | None = None  # Scans computed together, None for what suits the device

    def open(self) -> Callable[[], Pipeline[Any, Any, Any]]:
        """Load the network, unless it is there."""
        network = self.network or _loaded(self.settings)
        pipeline = network_pipeline(self.job(network), network, self.batch)
        return lambda: pipeline

    def __reduce__(self) -> tuple[Any, ...]:
        return NetworkTask, (self.job, self.settings, None, self.batch)


def network_pipeline(
    job: ScanJob[Prepared, Computed, Result], network: Network, batch: int | None = None
) -> Pipeline[Prepared, Computed, Result]:
    """Return the pipeline of a job: one scan at a time on a CPU, on a GPU as many as occupy it."""
    if network.device == "cpu":
        return Pipeline(job, BatchSize(batch or 1, "scans"))
    pixels = network.sensor.height * network.sensor.width
    usual = max(1, min(MAX_BATCH_SCANS, MAX_BATCH_PIXELS // pixels))
    readers = min(MAX_READERS, thread_count())
    return Pipeline(job, BatchSize(batch or usual, "scans"), readers, network.device)


def _loaded(settings: NetworkSettings) -> Network:
    """Load the network of this process, on a GPU of its own if it is a worker."""
    device = choose_device(settings.device)
    if device != "cpu":
        import torch

        device = own_device(settings.device, torch.cuda.device_count())
    return replace(settings, device=device).load()
