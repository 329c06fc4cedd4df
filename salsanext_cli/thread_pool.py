# SPDX-License-Identifier: MIT
"""The threads of this process that help with what can be shared."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache

MOST = 256
"""Threads; only as many are started as were ever busy together."""


def run_on_threads(work: Callable[[], object], hands: int) -> None:
    """Call ``work()`` on up to so many threads at once, this one among them.

    Returns when all calls are done. `work` should take what is left to do, if anything is: when
    this thread is done with its call, others that have not begun by then are not made. They must
    not wait for each other.
    """
    crew = _crew(os.getpid()) if hands > 1 else None
    helpers = [crew.submit(work) for _ in range(hands - 1)] if crew else []
    try:
        work()
    finally:
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


@lru_cache(maxsize=1)
def _crew(_process: int) -> ThreadPoolExecutor:
    """Return the threads; after a fork there are others."""
    return ThreadPoolExecutor(MOST, "salsanext")
