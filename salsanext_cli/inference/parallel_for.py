# SPDX-License-Identifier: MIT
"""Threads that share the parts of a computation, each part computed by one of them alone.

Libraries split a sum differently between other numbers of threads, and round it differently then.
Here what is one part does not depend on how many threads there are, so neither does a bit of the
result: not on the machine's cores, nor on how many processes share them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor

from salsanext_cli.thread_pool import run_on_threads

_own = threading.local()
_threads: ContextVar[int] = ContextVar("_threads", default=0)


@contextmanager
def single_threaded_torch() -> Iterator[None]:
    """Give the threads that torch has to `parallel_for` while the body runs.

    Torch itself has one then: its own threads wait for work by spinning, and would keep those of
    `parallel_for` from the cores.
    """
    if _threads.get():
        yield
        return
    threads = torch.get_num_threads()
    token = _threads.set(threads)
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        _threads.reset(token)


def parallel_for(work: Callable[[int], object], count: int) -> None:
    """Call ``work(0)`` to ``work(count - 1)`` on several threads; see `single_threaded_torch`.

    In each call torch has one thread. Calls must not write to the same places.
    """
    parts = iter(range(count))
    threads, of_torch = max(1, _threads.get()), torch.get_num_threads()

    # `next` of an iterator over a range is one step of the interpreter: no lock is needed.
    def pull() -> None:
        # Torch keeps the number for each thread by itself. Parts of a part are for the same thread.
        torch.set_num_threads(1)
        token = _threads.set(1)
        try:
            with torch.inference_mode():
                for part in parts:
                    work(part)
        finally:
            _threads.reset(token)

    try:
        run_on_threads(pull, min(threads, count) or 1)
    finally:
        torch.set_num_threads(of_torch)


def scratch(name: str, size: int) -> Tensor:
    """Return `size` float32 of this thread's own memory, whatever they hold.

    The same memory is given out under the same name again, so that it stays in the caches.
    """
    held: Tensor | None = getattr(_own, name, None)
    if held is None or len(held) < size:
        held = torch.empty(size)
        setattr(_own, name, held)
    return held[:size]
