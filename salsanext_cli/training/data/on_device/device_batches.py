# SPDX-License-Identifier: MIT
"""Batches that are made on the device of a training, equal in distribution to those of workers.

Each worker of torchrun draws from its share of the scans of every data set.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch

from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.wording import setting
from salsanext_cli.training.data.dataset import Batch, SampleKey, Samples
from salsanext_cli.training.data.on_device.batch_maker import BatchMaker
from salsanext_cli.training.data.on_device.lookahead import batches_ahead
from salsanext_cli.training.data.on_device.scan_store import ScanStore
from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup


def share_of(samples: Samples, group: ProcessGroup) -> Samples:
    """Return the share of the scans and of each batch that a worker of a group has."""
    if group.size == 1:
        return samples
    sources = [
        replace(source, files=source.files[group.rank :: group.size] or source.files)
        for source in samples.sources
    ]
    batch = len(range(group.rank, samples.recipe.batch, group.size))
    samples_per_epoch = samples.plan.steps_per_epoch * batch
    recipe = replace(samples.recipe, batch=batch, samples_per_epoch=samples_per_epoch)
    return replace(samples, sources=sources, recipe=recipe)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DeviceBatches:
    """Batches of a training, made from scans in the memory of its device.

    Attributes
    ----------
    samples : Samples
        Scans, sensor and recipe of the whole training.
    store : ScanStore
        Where the scans are kept.
    device : torch.device
        Device of the training.
    group : ProcessGroup
        Workers of the training.
    """

    samples: Samples
    store: ScanStore
    device: torch.device
    group: ProcessGroup = SINGLE_PROCESS

    def batches(self, first_step: int) -> Iterator[Batch]:
        """Yield a worker's share of each batch, from a step of the whole training to its end.

        Images and targets are on the device.
        """
        share = share_of(self.samples, self.group)
        maker = BatchMaker(
            samples=share,
            store=self.store,
            keys=self.store.read(share.sources),
            device=self.device,
            rank=self.group.rank,
        )
        makers = (partial(self._made, maker, keys) for keys in share.plan.batches(first_step))
        return batches_ahead(makers, self.device)

    def _made(self, maker: BatchMaker, keys: Sequence[SampleKey]) -> Batch:
        """Return a batch; while the device is too full, scans leave it."""
        try:
            return maker.make(keys)
        except torch.OutOfMemoryError as error:
            if not self._scans_leave():
                problem = f"not enough memory on {self.device} to make {len(keys)} of them"
                hint = f"use {setting('samples', 'workers')}, or set batch lower"
                raise TrainingError("samples", problem, hint=hint) from error
        # The error, which holds memory, is gone here.
        return self._made(maker, keys)

    def _scans_leave(self) -> bool:
        """Move half of the scans from a GPU to its host; return whether there were any."""
        return self.device.type == "cuda" and self.store.move_to_host()

    def free_device(self) -> bool:
        """Move half of the scans to the host; return whether there were any on the device.

        Workers that share a batch keep them, since the others cannot repeat the step.
        """
        return self.group.size == 1 and self._scans_leave()

    def paths(self, step: int) -> list[Path]:
        """Return the files of the images of a step, of all workers."""
        paths = []
        for rank in range(self.group.size):
            share = share_of(self.samples, replace(self.group, rank=rank))
            keys = next(share.plan.batches(step))
            paths += [share.scan_at(index)[1].path for _, index in keys]
        return paths
