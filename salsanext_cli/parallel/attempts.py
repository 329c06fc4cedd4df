# SPDX-License-Identifier: MIT
"""AttemptFunction at the scans of a run, by workers that joblib starts or connects to."""

from __future__ import annotations

import signal
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import joblib

from salsanext_cli.errors import WorkersLost
from salsanext_cli.parallel.chunks import chunks
from salsanext_cli.parallel.dask_pool import dask_pool
from salsanext_cli.parallel.options import RunOptions
from salsanext_cli.parallel.pools import WorkerPool, process_pool, thread_pool
from salsanext_cli.parallel.processes import signals_blocked
from salsanext_cli.parallel.ray_pool import ray_pool
from salsanext_cli.parallel.tasks import Attempt, Task
from salsanext_cli.parallel.worker import WORKER, WorkerContext, attempt_chunk
from salsanext_cli.storage.layout import ScanFile

PoolMaker = Callable[[RunOptions, int], AbstractContextManager[WorkerPool]]
"""Starts workers, or connects to them, and ends that afterwards; the number is of scans."""
POOLS: dict[str, PoolMaker] = {
    "loky": process_pool,
    "threading": thread_pool,
    "dask": dask_pool,
    "ray": ray_pool,
}
HARMLESS_WARNINGS = (
    # Who stops a run knows that it has been stopped.
    ".*tasks which were still being processed",
    # A worker that grows, as it does when it loads a network, is replaced by a fresh one.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib that say nothing to a user; raised as errors, they would stop its threads."""


def attempts_of_workers(
    task: Task, scans: Sequence[ScanFile], options: RunOptions, context: WorkerContext
) -> Generator[Attempt, None, None]:
    """Yield the attempts of all scans in no particular order, chunk by chunk.

    Raises
    ------
    WorkersLost
        If a worker died; that ends the run.
    """
    with warnings.catch_warnings():
        for message in HARMLESS_WARNINGS:
            warnings.filterwarnings("ignore", message)
        with POOLS[options.backend](options, len(scans)) as pool:
            context = replace(context, threads=pool.threads)
            attempt = partial(attempt_chunk, context, task)
            calls = (joblib.delayed(attempt)(chunk) for chunk in chunks(scans, pool.workers))
            try:
                yield from _results(calls, pool, options.backend)
            finally:
                # Joblib kills processes, but cannot kill threads and does not wait for them.
                WORKER.end(context.run)


def _results(
    calls: Iterator[Any], pool: WorkerPool, backend: str
) -> Generator[Attempt, None, None]:
    with joblib.parallel_config(**pool.backend):
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, pre_dispatch=pool.in_flight
        )
    try:
        with signals_blocked(signal.SIGINT, signal.SIGTERM) if backend == "loky" else nullcontext():
            found = parallel(calls)
        with closing(found):
            for of_chunk in found:
                yield from of_chunk
    except pool.died as error:
        raise WorkersLost(
            f"--backend {backend} --jobs {pool.workers}",
            "the system ended a worker",
            "memory for all of them",
            "use fewer jobs",
        ) from error
