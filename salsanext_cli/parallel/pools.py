# SPDX-License-Identifier: MIT
"""Worker pools of a run; those of this machine: processes, or threads of this process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from salsanext_cli.parallel.options import RunOptions
from salsanext_cli.parallel.processes import end_with_parent
from salsanext_cli.parallel.threads import cores, threads_each, threads_of_workers

CHUNKS_IN_FLIGHT = 2
"""Chunks sent for each worker, so that the next one is there when one is done."""


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers that are ready.

    Attributes
    ----------
    backend : dict
        Arguments of `joblib.parallel_config`.
    workers : int
        Number of chunks that are worked on side by side.
    in_flight : int
        Number of chunks that are sent before the first comes back.
    threads : int
        Threads that each worker may use.
    died : tuple of exception types
        Raised by the backend when a worker died.
    """

    backend: dict[str, Any]
    workers: int
    in_flight: int
    threads: int
    died: tuple[type[BaseException], ...] = ()


@contextmanager
def process_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Give a pool of processes, at most so many; joblib starts them with the first chunks."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    workers = min(max_workers, options.workers_here())
    threads = threads_each(cores(), workers)
    backend = {
        "backend": "loky",
        "n_jobs": workers,
        "inner_max_num_threads": threads,
        "initializer": end_with_parent,
        "initargs": (os.getpid(),),
    }
    yield WorkerPool(
        backend, workers, CHUNKS_IN_FLIGHT * workers, threads, (TerminatedWorkerError,)
    )


@contextmanager
def thread_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Give a pool of threads, at most so many."""
    workers = min(max_workers, options.workers_here())
    threads = threads_each(cores(), workers)
    backend = {"backend": "threading", "n_jobs": workers}
    with threads_of_workers(threads):
        yield WorkerPool(backend, workers, CHUNKS_IN_FLIGHT * workers, threads)
