# SPDX-License-Identifier: MIT
"""Batches of scans, passes or noisy copies that are computed together, as far as memory allows."""

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from salsanext_cli.errors import out_of_memory

Item = TypeVar("Item")
Result = TypeVar("Result")

log = logging.getLogger(__name__)


@dataclass(slots=True)
class BatchSize:
    """Number of items that are computed together; it is halved for good when memory runs out."""

    most: int
    name: str  # Of the items, in the plural

    def in_batches(
        self, function: Callable[[Sequence[Item]], Iterable[Result]], items: Sequence[Item]
    ) -> list[Result]:
        """Return the results of a function of batches; `MemoryError` if one item does not fit."""
        results: list[Result] = []
        while len(results) < len(items):
            batch = items[len(results) : len(results) + self.most]
            try:
                results.extend(function(batch))
            except (MemoryError, RuntimeError) as error:
                if not out_of_memory(error):
                    raise
                if len(batch) == 1:
                    raise MemoryError(f"no room for one of the {self.name}") from error
                self.most = len(batch) // 2
                text = "not enough memory for %d %s at once: %d now"
                log.warning(text, len(batch), self.name, self.most)
        return results
