# SPDX-License-Identifier: MIT
"""Threads that share the parts of a computation, each part computed by one of them alone.

Libraries split a sum differently between other numbers of threads, and round it differently then.
Here what is one part does not depend on how many threads there are, so neither does a bit of the
result: not on the machine's cores, nor on how many processes share them.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import torch
from torch import Tensor

_own = threading.local()


def in_parts(work: Callable[[int], object], count: int) -> None:
    """Call ``work(0)`` to ``work(count - 1)`` on as many threads as torch has been given.

    In each call torch has one thread. Calls must not write to the same places.
    """
    threads = torch.get_num_threads()
    if threads == 1:
        for part in range(count):
            work(part)
        return
    parts = iter(range(count))

    # `next` of an iterator over a range is one step of the interpreter: no lock is needed.
    def pull() -> None:
        with torch.inference_mode():
            for part in parts:
                work(part)

    helpers = [_crew(threads, os.getpid()).submit(pull) for _ in range(min(threads, count))]
    for helper in helpers:
        helper.result()


@lru_cache(maxsize=1)
def _crew(threads: int, _process: int) -> ThreadPoolExecutor:
    """Return threads of this process that have one torch thread each."""
    started = threading.Barrier(threads + 1)

    def begin() -> None:
        torch.set_num_threads(1)
        # Torch looks up the common setting on a thread's first question: now, while it is 1.
        torch.get_num_threads()
        started.wait()

    crew = ThreadPoolExecutor(threads, "salsanext", begin)
    for _ in range(threads):
        crew.submit(int)
    started.wait()
    # The setting of the thread that calls is what threads started later begin with.
    torch.set_num_threads(threads)
    return crew


def scratch(name: str, size: int) -> Tensor:
    """Return `size` float32 of this thread's own memory, whatever they hold.

    The same memory is given out under the same name again, so that it stays in the caches.
    """
    held: Tensor | None = getattr(_own, name, None)
    if held is None or len(held) < size:
        held = torch.empty(size)
        setattr(_own, name, held)
    return held[:size]
