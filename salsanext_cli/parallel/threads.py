# SPDX-License-Identifier: MIT
"""Numbers of workers and of their threads, so that all together use the cores once."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from salsanext_cli.errors import UsageError


def cores() -> int:
    """Return how many cores this process may use, which on a cluster are not all there are."""
    import joblib

    return int(joblib.cpu_count())


def worker_count(jobs: int) -> int:
    """Return how many workers `--jobs` asks for; -1 is one per core."""
    if jobs == 0 or jobs < -1:
        raise UsageError("--jobs", str(jobs), "a number of workers, or -1 for all cores")
    return cores() if jobs == -1 else jobs


def use_threads(count: int) -> None:
    """Let torch and our kernels use so many threads, in this thread and those started later.

    What is not loaded yet will not be used: work brings what it needs when it is unpickled.
    """
    if torch := _if_loaded("torch"):
        torch.set_num_threads(count)
    if numba := _if_loaded("numba"):
        numba.config.NUMBA_NUM_THREADS = count


def _if_loaded(name: str) -> Any:
    """Return a module that was imported before, complete; None for another.

    Importing it waits for another thread that is just importing it.
    """
    return import_module(name) if name in sys.modules else None


@contextmanager
def threads_of_workers(count: int) -> Iterator[None]:
    """Let threads that are started in the body use so many each, and afterwards as before.

    Torch keeps the number for each thread by itself; a new one begins with what was set last,
    wherever that was.
    """
    torch, numba = _if_loaded("torch"), _if_loaded("numba")
    of_torch = torch.get_num_threads() if torch else 0
    of_kernels = numba.config.NUMBA_NUM_THREADS if numba else 0
    use_threads(count)
    try:
        yield
    finally:
        if torch:
            torch.set_num_threads(of_torch)
        if numba:
            numba.config.NUMBA_NUM_THREADS = of_kernels
