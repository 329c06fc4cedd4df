# SPDX-License-Identifier: MIT
"""Jobs that need a network: each worker loads it once, if possible on a GPU that no other uses."""

import getpass
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from multiprocessing import current_process
from pathlib import Path
from typing import Any, TypeVar

from salsanext_cli.core.compiled import thread_count
from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.engines.device import MAX_BATCH_PIXELS, choose_device
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.runs.loop.job import Computed, Prepared, ScanJob
from salsanext_cli.runs.loop.job_memory import LABELS, SAMPLES, JobMemory
from salsanext_cli.runs.loop.pipeline import Pipeline
from salsanext_cli.runs.network_settings import NetworkSettings

MAX_BATCH_SCANS = 16  # Scans computed together on a GPU, and sent to a worker of a CPU
CHUNK_BATCHES = 4  # Batches sent to a worker of a GPU, which prepares the next during the last
MAX_READERS = 8  # Threads that prepare scans for a GPU

Result = TypeVar("Result")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkTask:
    """Job of a network, opened once per worker."""

    job: Callable[[Network], ScanJob[Any, Any, Any]]  # Returns the job of a network; picklable
    settings: NetworkSettings  # Resolved: each worker loads the same network
    network: Network | None = field(default=None, compare=False)  # Of this process only
    batch: int | None = None  # Scans computed together; None for a number that suits the device
    memory: JobMemory = LABELS  # Of a process with the job

    @property
    def max_chunk_scans(self) -> int:
        """Largest number of scans sent to a worker at once."""
        if self.settings.device == "cpu":
            return MAX_BATCH_SCANS
        return CHUNK_BATCHES * (self.batch or MAX_BATCH_SCANS)

    @property
    def worker_memory(self) -> int:
        """Estimated memory of a worker in bytes, beside that of a GPU, which has its images."""
        sensor = self.settings.sensor
        pixels = sensor.height * sensor.width if isinstance(sensor, Sensor) else 0
        images = (self.batch or 1) if self.settings.device == "cpu" else 1
        return self.memory.estimate(images * pixels)

    def open(self) -> Pipeline[Any, Any, Any]:
        """Load the network, if this process has none."""
        network = self.network or _loaded(self.settings)
        return network_pipeline(self.job(network), network, self.batch)

    def __reduce__(self) -> tuple[Any, ...]:
        names = ("job", "settings", "batch", "memory")
        return partial(NetworkTask, **{name: getattr(self, name) for name in names}), ()


def sampling_task(
    job: Callable[[Network], ScanJob[Any, Any, Any]],
    settings: NetworkSettings,
    network: Network,
    memory: JobMemory = SAMPLES,
) -> NetworkTask:
    """Return the task of a job that computes several passes of one scan after the other."""
    return NetworkTask(job=job, settings=settings, network=network, batch=1, memory=memory)


def network_pipeline(
    job: ScanJob[Prepared, Computed, Result], network: Network, batch: int | None = None
) -> Pipeline[Prepared, Computed, Result]:
    """Return the pipeline of a job: one scan at a time on a CPU, a batch on a GPU."""
    if network.device == "cpu":
        return Pipeline(job=job, batch=BatchSize(batch or 1, "scans"))
    pixels = network.sensor.height * network.sensor.width
    default = max(1, min(MAX_BATCH_SCANS, MAX_BATCH_PIXELS // pixels))
    readers = min(MAX_READERS, thread_count())
    return Pipeline(
        job=job, batch=BatchSize(batch or default, "scans"), readers=readers, device=network.device
    )


def _loaded(settings: NetworkSettings) -> Network:
    device = choose_device(settings.device)
    if device != "cpu":
        import torch

        device = device_of_worker(settings.device, torch.cuda.device_count())
    return replace(settings, device=device).load()


def device_of_worker(device: str, gpus: int) -> str:
    """Return the device; in worker processes, "auto" and "cuda" are distributed over the GPUs."""
    is_worker = current_process().name != "MainProcess"
    if not is_worker or device not in ("auto", "cuda") or gpus < 2:
        return device
    return f"cuda:{_worker_number()[0] % gpus}"


@cache
def _worker_number() -> tuple[int, object]:
    """Take the lowest number that no live worker of this machine has, and the lock on it."""
    from filelock import FileLock, Timeout

    try:
        folder = _folder_of_numbers()
        number = 0
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        while True:
            lock = FileLock(folder / str(number))
            try:
                lock.acquire(timeout=0)
            except Timeout:
                number += 1
            else:
                return number, lock
    except (OSError, NotImplementedError) as error:
        log.warning("GPUs are assigned randomly, because workers cannot be counted: %s", error)
        return os.getpid(), None


def _folder_of_numbers() -> Path:
    """Return a folder of this user; processes that see other GPUs are counted separately."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    digest = hashlib.sha256(visible.encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"salsanext-gpus-{getpass.getuser()}-{digest}"
