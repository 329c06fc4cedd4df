# SPDX-License-Identifier: MIT
"""Batches that are halved where memory runs out."""

import logging
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from salsanext_cli.errors import out_of_memory

log = logging.getLogger(__name__)
Item = TypeVar("Item")
Result = TypeVar("Result")


def halved_batches(
    function: Callable[[Sequence[Item]], Iterable[Result]],
    items: Sequence[Item],
    most: int,
    name: str,
    sizes: dict[str, int],
) -> list[Result]:
    """Return the results of a function of batches, halved where memory runs out.

    `function`: takes some of the items, yields a result of each; `most`: items at once, as long as
    there is room; `name`: of the items, in the plural; `sizes`: number of items by name that there
    was room for at once; is filled.
    """
    found: list[Result] = []
    while len(found) < len(items):
        size = min(most, sizes.get(name, most))
        batch = items[len(found) : len(found) + size]
        try:
            found.extend(function(batch))
        except (MemoryError, RuntimeError) as error:
            if not out_of_memory(error):
                raise
            if len(batch) == 1:
                raise MemoryError(f"no room for one of the {name}") from error
            size = sizes[name] = len(batch) // 2
            log.warning("not enough memory for %d %s at once: %d now", len(batch), name, size)
    return found
