# SPDX-License-Identifier: MIT
"""Pool of threads of this process, for work that can be shared."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache

MAX_THREADS = 256
"""Only as many are started as were ever busy together."""


def run_on_threads(work: Callable[[], object], count: int) -> None:
    """Call ``work()`` on up to `count` threads at once, this one among them.

    Returns when all calls are done. `work` should take what is left to do, if anything is: when
    this thread is done with its call, others that have not begun by then are not made. They must
    not wait for each other.
    """
    others = [_pool(os.getpid()).submit(work) for _ in range(count - 1)]
    try:
        work()
    finally:
        begun = [call for call in others if not call.cancel()]
        wait(begun)
    for call in begun:
        call.result()


@lru_cache(maxsize=1)
def _pool(_process: int) -> ThreadPoolExecutor:
    """Return the threads; after a fork there are others."""
    return ThreadPoolExecutor(MAX_THREADS, "salsanext")
