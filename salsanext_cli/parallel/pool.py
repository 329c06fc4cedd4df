# SPDX-License-Identifier: MIT
"""Workers of a run: processes (joblib's loky) or threads of this machine."""

import os
import signal
import warnings
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing, contextmanager
from functools import partial
from itertools import groupby, pairwise
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Event
from typing import Any
from uuid import uuid4

from salsanext_cli.errors import WorkersLost
from salsanext_cli.files.atomic import MARK
from salsanext_cli.parallel.job import Attempt, OpenableTask, Task
from salsanext_cli.parallel.pipeline import opened
from salsanext_cli.parallel.run_options import RunOptions, cores, threads_of_workers
from salsanext_cli.parallel.worker import (
    Chunk,
    WorkerContext,
    attempt_chunk,
    attempts_of_chunk,
    end_with_parent,
)
from salsanext_cli.results.paths import ScanFile

CHUNKS_IN_FLIGHT = 2  # Chunks sent per worker, so that the next is ready when one is done
HARMLESS_WARNINGS = (
    # The user has stopped the run.
    ".*tasks which were still being processed",
    # A worker that grows while it loads a network is replaced.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib without use for a user; raised as errors, they would stop its threads."""
MAX_CHUNK_SCANS = 16
"""Bound of the work that is lost with a worker, and of the scans between signs of progress."""
MIN_CHUNKS_PER_WORKER = 4  # Lower bound, so that the last chunks end at about the same time

Results = Generator[list[Attempt[Any]], None, None]


def attempts_of_workers(
    task: Task, scans: Sequence[ScanFile], options: RunOptions
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts of workers, in no particular order."""
    workers = min(len(scans), options.workers())
    threads = max(1, cores() // workers)
    most = task.max_chunk_scans if isinstance(task, OpenableTask) else MAX_CHUNK_SCANS
    stop = options.on_error == "stop"
    context = WorkerContext(uuid4().hex, MARK.get(), stop, Path.cwd(), threads)
    work = by_threads if options.backend == "threading" else by_processes
    with closing(work(task, chunks(scans, workers, most), context, workers)) as results:
        for of_chunk in results:
            yield from of_chunk


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


def by_threads(task: Task, cut: Sequence[Chunk], context: WorkerContext, workers: int) -> Results:
    """Yield the attempts of each chunk by threads, which finish their scans when this is closed."""
    stopping = Event()

    def work(chunk: Chunk) -> list[Attempt[Any]]:
        MARK.set(context.mark)
        return attempts_of_chunk(attempts, chunk, stopping.is_set, stop=context.stop)

    with threads_of_workers(context.threads), ThreadPoolExecutor(workers) as pool:
        attempts = opened(task)
        try:
            for future in as_completed([pool.submit(work, chunk) for chunk in cut]):
                yield future.result()
        finally:
            stopping.set()
            pool.shutdown(cancel_futures=True)


def by_processes(task: Task, cut: Sequence[Chunk], context: WorkerContext, workers: int) -> Results:
    """Yield the attempts of each chunk by processes, which are killed when this is closed."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    backend = joblib.parallel_config(
        "loky",
        n_jobs=workers,
        inner_max_num_threads=context.threads,
        initializer=end_with_parent,
        initargs=(os.getpid(),),
    )
    with warnings.catch_warnings():
        for message in HARMLESS_WARNINGS:
            warnings.filterwarnings("ignore", message)
        with backend:
            parallel = joblib.Parallel(
                return_as="generator_unordered",
                batch_size=1,
                pre_dispatch=CHUNKS_IN_FLIGHT * workers,
            )
        with signals_blocked(signal.SIGINT, signal.SIGTERM):
            work = joblib.delayed(partial(attempt_chunk, context, task))
            results = parallel(map(work, cut))
        try:
            with closing(results):
                yield from results
        except TerminatedWorkerError as error:
            problem, hint = "the system ended a worker", "use fewer jobs, which need less memory"
            raise WorkersLost(f"--jobs {workers}", problem, hint=hint) from error


@contextmanager
def signals_blocked(*signals: signal.Signals) -> Generator[None, None, None]:
    """Start threads and processes that signals do not reach, because this thread ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from joblib.externals.loky.backend import resource_tracker as tracker_of_loky

    # Started before, because starting these unblocks the signals.
    tracker_of_loky.ensure_running()
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
