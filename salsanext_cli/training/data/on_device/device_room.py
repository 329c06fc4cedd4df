# SPDX-License-Identifier: MIT
"""Room for the scans of a training on its device and the host, and what they need."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from salsanext_cli.core.notices import NOTICE
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.scans.selection import evenly_spaced
from salsanext_cli.training.data.on_device.scan_memory import BYTES_PER_POINT, host_reserve
from salsanext_cli.training.data.sources import Source
from salsanext_cli.training.learner import validation_precision
from salsanext_cli.training.memory import memory_of
from salsanext_cli.training.step_memory import StepMemory

ESTIMATED_SCANS = 8  # Scans of a data set that are read for the estimate
BYTES_PER_IMAGE = 150_000_000
"""Memory to make an image of a batch: 92 MB were measured with `modern` and 120 000 points."""
VALIDATION_BYTES = {"float32": 9_600_000_000, "bfloat16": 2_700_000_000, "float16": 2_700_000_000}
"""Peak of the network on the largest batch of a validation, by number type.

docs/experiments/gpu-h200.json has the measurements; the highest of them counts here.
"""
VALIDATION_SHARE = 0.25
"""Largest share of a device that stays free for a validation.

Without memory for a batch, a validation goes on with half of it, and takes longer. Scans that are
on the host instead take time in every step. In float32 a scan of the largest batch needs 600 MB:
a quarter of 8 GB has room for three of the 16.
"""
USED_SHARE = 0.8  # Largest share of the available memory that scans should need

log = logging.getLogger(__name__)


def bytes_of_scans(sources: Sequence[Source]) -> int:
    """Return the estimated size of the scans of data sets in memory, in bytes."""
    points = 0.0
    for source in sources:
        files = evenly_spaced(source.files, ESTIMATED_SCANS)
        counts = [len(read_scan(file.path, source.sensor_of(file))) for file in files]
        points += len(source.files) * sum(counts) / max(len(counts), 1)
    return int(BYTES_PER_POINT * points)


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceRoom:
    """Room for the scans of a worker.

    Attributes
    ----------
    device : torch.device
        Device of the worker.
    step : StepMemory, optional
        Images that the worker computes at once; None for an unknown network.
    workers : int
        Number of workers that share the scans.
    workers_here : int
        Number of workers that share the memory of the host.
    """

    device: torch.device
    step: StepMemory | None
    workers: int = 1
    workers_here: int = 1

    @property
    def reserve(self) -> int:
        """Bytes of the device that stay free for steps, validation and samples.

        It is half of the device for unknown steps.
        """
        if self.step is not None:
            images = math.ceil(self.step.recipe.batch / self.workers)
            return max(self.step.room, self._validation) + images * BYTES_PER_IMAGE
        memory = memory_of(str(self.device))
        return memory.total // 2 if memory else 0

    @property
    def _validation(self) -> int:
        """Bytes left to a validation after the steps; a CPU validates scan by scan."""
        if self.step is None or self.device.type == "cpu":
            return 0
        needed = VALIDATION_BYTES[validation_precision(self.device)]
        memory = memory_of(str(self.device))
        return min(needed, int(VALIDATION_SHARE * memory.total)) if memory else needed

    def has_room_for(self, sources: Sequence[Source]) -> bool:
        """Return whether the scans fit into the device and the host together; log if not."""
        host = memory_of("cpu")
        if host is None:
            return True
        available = host.available // self.workers_here
        if self.device.type == "cpu":
            available -= self.reserve
        elif memory := memory_of(str(self.device)):
            available = max(host.available - host_reserve(host), 0) // self.workers_here
            available += max(memory.available - self.reserve, 0)
        needed = bytes_of_scans(sources) // self.workers
        if needed <= USED_SHARE * available:
            return True
        text = "the scans need about %.3g GB of memory: processes read them for each batch"
        log.log(NOTICE, text, needed / 1e9)
        return False
