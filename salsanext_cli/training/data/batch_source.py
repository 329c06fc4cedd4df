# SPDX-License-Identifier: MIT
"""Where a training gets its batches from: worker processes make them, or its device does."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from salsanext_cli.training.data.dataset import Batch, Samples, batches
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup

DEVICE = "device"
WORKERS = "workers"
"""Kinds of samples: made on the device of the training, or by worker processes."""


class BatchSource(Protocol):
    """Source of the batches of a training."""

    @property
    def samples(self) -> Samples:
        """Scans, sensor and recipe of the whole training."""

    def batches(self, first_step: int) -> Iterator[Batch]:
        """Yield a worker's share of each batch, from a step of the whole training to its end."""

    def paths(self, step: int) -> list[Path]:
        """Return the files of the images of a step, of all workers."""

    def free_device(self) -> bool:
        """Free memory of the device for a step; return whether there was any to free."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WorkerBatches:
    """Batches that worker processes make.

    Attributes
    ----------
    samples : Samples
        Scans, sensor and recipe of the whole training.
    workers : int
        Number of processes; 0 for none beside that of the training.
    pinned : bool
        Whether batches are in pinned memory, from which a GPU copies.
    group : ProcessGroup
        Workers of the training.
    """

    samples: Samples
    workers: int = 0
    pinned: bool = False
    group: ProcessGroup = SINGLE_PROCESS

    def batches(self, first_step: int) -> Iterator[Batch]:
        """Yield a worker's share of each batch, from a step of the whole training to its end."""
        return batches(self.samples, first_step, self.workers, pinned=self.pinned, group=self.group)

    def paths(self, step: int) -> list[Path]:
        """Return the files of the images of a step, of all workers."""
        keys = next(self.samples.plan.batches(step))
        return [self.samples.scan_at(index)[1].path for _, index in keys]

    def free_device(self) -> bool:
        """Return False: nothing is kept on the device."""
        return False
