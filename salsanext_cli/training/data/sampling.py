# SPDX-License-Identifier: MIT
"""Order in which a training draws its samples, the same wherever it is resumed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from salsanext_cli.training.distributed import SINGLE_PROCESS, ProcessGroup
from salsanext_cli.training.recipe import Recipe

ORDER = 0
"""Purpose of the generator of orders, a part of its seed beside those of other modules."""

SampleKey = tuple[int, int]
"""Position of a sample in the whole training, index of its scan."""


@dataclass(frozen=True, slots=True)
class SamplingPlan:
    """Batches of the whole training, each a list of sample keys.

    Every scan of a data set is drawn once before any is drawn again, and every batch is whole: the
    last one of an epoch goes on with the next round of scans. A batch of one or two would upset the
    statistics of batch norm just before they are validated. Data sets behind the first have the
    share `recipe.also` of the samples, all of them as many.
    """

    scan_counts: Sequence[int]
    recipe: Recipe

    @property
    def steps_per_epoch(self) -> int:
        """Number of batches of an epoch, which hold all its samples."""
        return -(-(self.recipe.samples_per_epoch or sum(self.scan_counts)) // self.recipe.batch)

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
        orders: dict[int, tuple[int, list[int]]] = {}
        while True:
            source, draw = self._draw(position)
            number, place = divmod(draw, self.scan_counts[source])
            if orders.get(source, (-1, []))[0] != number:
                orders[source] = number, self._order(source, number)
            yield position, orders[source][1][place]
            position += 1

    def _draw(self, position: int) -> tuple[int, int]:
        """Return the data set of a position, and how often it was drawn from before."""
        others = len(self.scan_counts) - 1
        share = self.recipe.also if others else 0.0
        further = int(position * share)
        if int((position + 1) * share) == further:
            return 0, position - further
        return 1 + further % others, further // others

    def _order(self, source: int, number: int) -> list[int]:
        """Return the indices of a data set's scans in the order of a round, counted from 0."""
        seed = (self.recipe.seed, ORDER, number, *((source,) if source else ()))
        order = np.random.default_rng(seed).permutation(self.scan_counts[source])
        return [sum(self.scan_counts[:source]) + int(i) for i in order]
