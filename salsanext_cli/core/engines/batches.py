# SPDX-License-Identifier: MIT
"""Batches of scans, passes or noisy copies that are computed together, as far as memory allows."""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from salsanext_cli.core.engines.memory import out_of_memory

Item = TypeVar("Item")
Result = TypeVar("Result")

log = logging.getLogger(__name__)


@dataclass(slots=True)
class BatchSize:
    """Number of items that are computed together, halved permanently when memory runs out."""

    most: int
    name: str  # Noun for the items, in the plural

    def in_batches(
        self, function: Callable[[Sequence[Item]], Result], items: Sequence[Item]
    ) -> Iterator[Result]:
        """Yield the result of each batch; raise `MemoryError` if one item does not fit."""
        done = 0
        while done < len(items):
            batch = items[done : done + self.most]
            try:
                result = function(batch)
            except (MemoryError, RuntimeError) as error:
                if not out_of_memory(error):
                    raise
                if len(batch) == 1:
                    raise MemoryError(f"not enough memory for one of the {self.name}") from error
                self.most = min(self.most, len(batch) // 2)
                text = "batch: not enough memory for %d %s at once; continuing with %d"
                log.warning(text, len(batch), self.name, self.most)
            else:
                done += len(batch)
                yield result
