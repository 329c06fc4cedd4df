# SPDX-License-Identifier: MIT
"""Thread pool of the process, for work on shared arrays."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache

MAX_THREADS = 256
"""Size of the pool, which starts only as many threads as are busy together."""


def run_on_threads(work: Callable[[], object], threads: int) -> None:
    """Call ``work()`` on up to `threads` threads at once, this one among them.

    Returns when all calls are done. Each call should do what remains of the work: calls that have
    not begun when this thread is done are cancelled. They must not wait for each other.
    """
    pool = _pool(os.getpid()) if threads > 1 else None
    calls = [pool.submit(work) for _ in range(threads - 1)] if pool else []
    try:
        work()
    finally:
        begun = [call for call in calls if not call.cancel()]
        wait(begun)
    for call in begun:
        call.result()


@lru_cache(maxsize=1)
def _pool(_process: int) -> ThreadPoolExecutor:
    """Return the pool of a process; after a fork it is a new one."""
    return ThreadPoolExecutor(MAX_THREADS, "salsanext")
