# SPDX-License-Identifier: MIT
"""The threads of this process that help with what can be shared."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import lru_cache


def all_hands(work: Callable[[], object], hands: int) -> None:
    """Call ``work()`` on so many threads at once, this one among them; return when all are done.

    The threads are started once. They must not wait for each other, nor call this.
    """
    helpers = hands - 1
    with ExitStack() as ends:
        for _ in range(helpers):
            ends.callback(_crew(helpers, os.getpid()).submit(work).result)
        work()


@lru_cache(maxsize=2)
def _crew(size: int, _process: int) -> ThreadPoolExecutor:
    """Return the threads; after a fork there are others."""
    return ThreadPoolExecutor(size, "salsanext")
