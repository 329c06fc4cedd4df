# SPDX-License-Identifier: MIT
"""Workers of a run: threads and processes of this machine (joblib), or a Dask cluster."""

import os
import signal
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice, pairwise
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any
from uuid import uuid4

from salsanext_cli.errors import UsageError, WorkersLost
from salsanext_cli.files.atomic import MARK
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.parallel.job import Attempt, OpenableTask, Task
from salsanext_cli.parallel.run_options import RunOptions, cores, threads_of_workers
from salsanext_cli.parallel.worker import (
    WORKER,
    Chunk,
    WorkerContext,
    attempt_chunk,
    end_with_parent,
)
from salsanext_cli.results.paths import ScanFile

CHUNKS_IN_FLIGHT = 2  # Chunks sent per worker, so that the next is there when one is done
CONNECT_TIMEOUT_S = 15  # For a scheduler and a first worker
HARMLESS_WARNINGS = (
    # Who stops a run knows that it has been stopped.
    ".*tasks which were still being processed",
    # A worker that grows, as it does when it loads a network, is replaced by a fresh one.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib that say nothing to a user; raised as errors, they would stop its threads."""

MAX_CHUNK_SCANS = 16
"""Bound of the work that is lost with a worker, and of the scans between signs of progress."""
MIN_CHUNKS_PER_WORKER = 4  # Lower bound, so that the last chunks end about together

Work = Callable[[Chunk], list[Attempt[Any]]]
Results = Generator[list[Attempt[Any]], None, None]


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers that are ready."""

    # Yields what the workers return for each chunk, in the order in which they finish
    run: Callable[[Work, Sequence[Chunk]], Results]
    workers: int  # Number of chunks that are worked on side by side
    threads: int  # Threads that each worker may use
    died: tuple[type[BaseException], ...]  # Raised by `run` when a worker died


def attempts_of_workers(
    task: Task, scans: Sequence[ScanFile], options: RunOptions
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts that workers make, in no particular order."""
    stop, most = options.on_error == "stop", MAX_CHUNK_SCANS
    if isinstance(task, OpenableTask):
        most = task.max_chunk_scans
    opened = dask_pool(options) if options.backend == "dask" else local_pool(options, len(scans))
    with warnings.catch_warnings():
        for message in HARMLESS_WARNINGS:
            warnings.filterwarnings("ignore", message)
        with opened as pool:
            context = WorkerContext(uuid4().hex, MARK.get(), stop, Path.cwd(), pool.threads)
            work = partial(attempt_chunk, context, task)
            try:
                with closing(pool.run(work, chunks(scans, pool.workers, most))) as of_chunks:
                    for of_chunk in of_chunks:
                        yield from of_chunk
            except pool.died as error:
                subject = f"--backend {options.backend} --jobs {pool.workers}"
                found, expected = "the system ended a worker", "memory for all of them"
                raise WorkersLost(subject, found, expected, "use fewer jobs") from error
            finally:
                # Joblib kills processes, but cannot kill threads and does not wait for them.
                WORKER.end(context.run)


def chunks(scans: Sequence[ScanFile], workers: int, most: int = MAX_CHUNK_SCANS) -> list[Chunk]:
    """Cut scans, in order, into chunks of one sequence and at most `most`, of similar sizes."""
    size = max(1, min(most, len(scans) // (MIN_CHUNKS_PER_WORKER * workers)))
    cut: list[Chunk] = []
    for _, group in groupby(scans, key=lambda scan: scan.sequence):
        run = tuple(group)
        parts = -(-len(run) // size)
        borders = [len(run) * part // parts for part in range(parts + 1)]
        cut += [run[start:stop] for start, stop in pairwise(borders)]
    return cut


@contextmanager
def local_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Give a pool of threads or processes, at most so many; joblib starts them when needed."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    workers = min(max_workers, options.workers_here())
    threads = max(1, cores() // workers)
    backend: dict[str, Any] = {"backend": options.backend, "n_jobs": workers}
    if options.backend == "loky":
        backend |= {"initializer": end_with_parent, "initargs": (os.getpid(),)}
        backend["inner_max_num_threads"] = threads
    pool = WorkerPool(partial(_run_here, backend), workers, threads, (TerminatedWorkerError,))
    with threads_of_workers(threads) if options.backend == "threading" else nullcontext():
        yield pool


def _run_here(backend: dict[str, Any], work: Work, cut: Sequence[Chunk]) -> Results:
    import joblib

    is_loky, in_flight = backend["backend"] == "loky", CHUNKS_IN_FLIGHT * backend["n_jobs"]
    with joblib.parallel_config(**backend):
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, pre_dispatch=in_flight
        )
    with signals_blocked(signal.SIGINT, signal.SIGTERM) if is_loky else nullcontext():
        attempts = parallel(joblib.delayed(work)(chunk) for chunk in cut)
    with closing(attempts):
        yield from attempts


@contextmanager
def signals_blocked(*signals: signal.Signals) -> Generator[None, None, None]:
    """Start threads and processes that signals do not reach, since this thread ends them."""
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


@contextmanager
def dask_pool(options: RunOptions) -> Iterator[WorkerPool]:
    """Connect to the workers of a scheduler."""
    distributed = import_extra("distributed", "dask")
    with ExitStack() as held:
        try:
            made = distributed.Client(
                options.scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False
            )
            client = held.enter_context(made)
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            expected = "a Dask scheduler with workers, such as tcp://host:8786"
            subject = f"--scheduler {options.scheduler}"
            raise UsageError(subject, _first_line(error), expected) from error
        slots = sum(client.nthreads().values())
        limit = options.workers_of_cluster()
        workers = limit or slots

        def run(work: Work, cut: Sequence[Chunk]) -> Results:
            left = (client.submit(partial(work, chunk), pure=False) for chunk in cut)
            first = islice(left, limit or CHUNKS_IN_FLIGHT * workers)
            sent = distributed.as_completed(first, loop=client.loop)
            for future in sent:
                sent.update(islice(left, 1))
                yield future.result()

        died = (distributed.scheduler.KilledWorker, CancelledError)
        yield WorkerPool(run, workers, max(1, slots // workers), died)


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
