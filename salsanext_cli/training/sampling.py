# SPDX-License-Identifier: MIT
"""Order of a training: the scans that are drawn at each step, and by which worker."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.recipe import Recipe

ORDER, SAMPLE = 0, 1
"""Purposes of generators, a part of their seeds, so that no two are alike."""

SampleKey = tuple[int, int]
"""Position of a sample in the whole training, index of its scan."""


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """Batches of the whole training, each a list of sample keys.

    Every scan is drawn once before any is drawn again, and every batch is whole: the last one of an
    epoch goes on with the next round of scans. A batch of one or two would upset the statistics of
    batch norm just before they are validated.

    Attributes
    ----------
    scan_count : int
    recipe : Recipe
    """

    scan_count: int
    recipe: Recipe

    @property
    def steps_per_epoch(self) -> int:
        """Number of batches of an epoch, which hold all its samples."""
        return -(-(self.recipe.samples_per_epoch or self.scan_count) // self.recipe.batch)

    @property
    def steps(self) -> int:
        """Number of batches of the whole training."""
        return self.steps_per_epoch * self.recipe.epochs

    def crop_width(self, position: int) -> int:
        """Return the columns of the window of a sample, 0 for the full circle."""
        epoch = position // (self.steps_per_epoch * self.recipe.batch)
        last = epoch >= self.recipe.epochs - self.recipe.whole_epochs
        return 0 if self.recipe.whole_epochs and last else self.recipe.crop_width

    def batches(
        self, first_step: int = 0, group: ProcessGroup = SINGLE_PROCESS
    ) -> Iterator[list[SampleKey]]:
        """Yield a worker's share of each batch, from a step of the whole training to its end.

        The shares of all workers together are the batch that one alone would have.
        """
        keys = self._keys(first_step * self.recipe.batch)
        for _ in range(first_step, self.steps):
            yield list(islice(keys, self.recipe.batch))[group.rank :: group.size]

    def _keys(self, position: int) -> Iterator[SampleKey]:
        """Yield keys without end, from a position of the whole training."""
        while True:
            time, place = divmod(position, self.scan_count)
            random = np.random.default_rng((self.recipe.seed, ORDER, time))
            for index in random.permutation(self.scan_count)[place:]:
                yield position, int(index)
                position += 1
