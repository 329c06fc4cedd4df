# SPDX-License-Identifier: MIT
"""The workers of a run: processes, threads, or those of a Dask or Ray cluster."""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from salsanext_cli.parallel.tasks import WorkerContext
from salsanext_cli.parallel.threads import cores, threads_each, threads_of_workers

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import RunOptions

AHEAD = 2
"""Chunks sent for each worker, so that the next one is there when one is done."""


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers that are ready.

    Attributes
    ----------
    parallel : dict
        What `joblib.parallel_config` takes.
    workers : int
        How many chunks are worked on side by side.
    errand : Errand
        What each is told.
    in_flight : int
        How many chunks are sent before the first comes back.
    """

    parallel: dict[str, Any]
    workers: int
    context: WorkerContext
    in_flight: int


Maker = Callable[["RunOptions", int, WorkerContext], AbstractContextManager[WorkerPool]]
"""Starts workers, or connects to them, and lets go of them afterwards. Takes how many chunks there
are at most, and what the errand says on every backend."""


def crew(
    options: RunOptions, most: int, context: WorkerContext
) -> AbstractContextManager[WorkerPool]:
    """Return the workers of a backend, to be entered.

    Parameters
    ----------
    options : BatchOptions
        Backend, jobs and scheduler.
    most : int
        More workers than that have nothing to do.
    errand : Errand
        What the backend adds its part to.

    Raises
    ------
    MissingDependency
        If the package of the backend is not installed.
    UsageError
        If no cluster answers at the address.
    """
    from salsanext_cli.parallel.dask_backend import dask_crew
    from salsanext_cli.parallel.ray_backend import ray_crew

    makers: dict[str, Maker] = {
        "loky": _processes,
        "threading": _threads,
        "dask": dask_crew,
        "ray": ray_crew,
    }
    return makers[options.backend](options, most, context)


@contextmanager
def _processes(options: RunOptions, most: int, context: WorkerContext) -> Iterator[WorkerPool]:
    workers = min(most, options.workers_here())
    threads = threads_each(cores(), workers)
    parallel = {"backend": "loky", "n_jobs": workers, "inner_max_num_threads": threads}
    yield WorkerPool(parallel, workers, replace(context, folder=Path.cwd()), AHEAD * workers)


class _ThreadPool:
    """Threads as a pool."""

    def __init__(self, executor: ThreadPoolExecutor) -> None:
        self.executor = executor

    def send(self, call: Callable[[], Any]) -> Future[Any]:
        return self.executor.submit(call)

    def result_of(self, future: Future[Any]) -> Any:
        return future.result()

    def cancel(self, futures: list[Future[Any]]) -> None:
        for future in futures:
            future.cancel()


@contextmanager
def _threads(options: RunOptions, most: int, context: WorkerContext) -> Iterator[WorkerPool]:
    from salsanext_cli.parallel.futures import FuturesBackend

    workers = min(most, options.workers_here())
    ended = Event()
    threads = threads_each(cores(), workers)
    # Set in each as well: what new ones begin with is what torch was told last, anywhere.
    context = replace(context, threads=threads)
    with threads_of_workers(threads):
        executor = ThreadPoolExecutor(workers)
        backend = FuturesBackend(_ThreadPool(executor), workers)
        parallel = {"backend": backend, "n_jobs": workers}
        try:
            yield WorkerPool(
                parallel, workers, replace(context, ended=ended.is_set), AHEAD * workers
            )
        finally:
            # Nobody can end a thread: each finishes the scan that it is at.
            ended.set()
            executor.shutdown(cancel_futures=True)


@contextmanager
def block_interrupts() -> Generator[None, None, None]:
    """Start threads and processes that Ctrl-C does not reach: it is this thread that ends them.

    A process inherits the signals that the thread which starts it has blocked, so workers that
    joblib starts later, from a thread of its own, are deaf too.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from joblib.externals.loky.backend import resource_tracker as tracker_of_loky

    # Starting these lets the signal through again, so they are started before.
    tracker_of_loky.ensure_running()
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
