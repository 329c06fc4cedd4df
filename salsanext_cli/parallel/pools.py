# SPDX-License-Identifier: MIT
"""Worker pools of this machine: threads, and processes that never live longer than their parent."""

import os
import signal
import threading
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any

from salsanext_cli.parallel.options import RunOptions, cores, threads_of_workers

CHUNKS_IN_FLIGHT = 2
"""Chunks sent for each worker, so that the next one is there when one is done."""
POLL_INTERVAL_S = 1.0


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers that are ready."""

    backend: dict[str, Any]  # Arguments of `joblib.parallel_config`
    workers: int  # Number of chunks that are worked on side by side
    in_flight: int  # Number of chunks that are sent before the first comes back
    threads: int  # Threads that each worker may use
    died: tuple[type[BaseException], ...] = ()  # Raised by the backend when a worker died


@contextmanager
def local_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Give a pool of threads or processes, at most so many; joblib starts them when needed."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    workers = min(max_workers, options.workers_here())
    threads = max(1, cores() // workers)
    backend: dict[str, Any] = {"backend": options.backend, "n_jobs": workers}
    if options.backend == "threading":
        with threads_of_workers(threads):
            yield WorkerPool(backend, workers, CHUNKS_IN_FLIGHT * workers, threads)
        return
    watched = {"initializer": end_with_parent, "initargs": (os.getpid(),)}
    backend |= {"inner_max_num_threads": threads, **watched}
    died = (TerminatedWorkerError,)
    yield WorkerPool(backend, workers, CHUNKS_IN_FLIGHT * workers, threads, died)


@contextmanager
def signals_blocked(*signals: signal.Signals) -> Generator[None, None, None]:
    """Start threads and processes that signals do not reach, since this thread ends them.

    A process inherits the signals that the thread which starts it has blocked, so that holds too
    for workers that joblib starts later, from a thread of its own.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from joblib.externals.loky.backend import resource_tracker as tracker_of_loky

    # Starting these lets the signals through again, so they are started before.
    tracker_of_loky.ensure_running()
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent(parent: int) -> None:
    """Let this process end within seconds of the process that started it, even while it is idle.

    A parent that is killed cannot end its workers.

    `parent`: process id.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_INTERVAL_S)
        os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()
