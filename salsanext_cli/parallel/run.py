# SPDX-License-Identifier: MIT
"""Run of one task over many scans: some done already, some in parallel, some failing."""

import logging
import signal
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

from salsanext_cli.errors import WorkersLost, first_few
from salsanext_cli.files.atomic import MARK
from salsanext_cli.measures.scan_summary import RunSummary
from salsanext_cli.parallel.options import CLUSTERS, Progress, RunOptions
from salsanext_cli.parallel.shards import Chunk, chunks
from salsanext_cli.parallel.worker import (
    WORKER,
    Attempt,
    Task,
    WorkerContext,
    WorkerPool,
    attempt_chunk,
    local_pool,
    opened,
    signals_blocked,
)
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.selection import MissingResults

__all__ = ["Failure", "Outcome", "Progress", "RunOptions", "run_over_scans"]

HARMLESS_WARNINGS = (
    # Who stops a run knows that it has been stopped.
    ".*tasks which were still being processed",
    # A worker that grows, as it does when it loads a network, is replaced by a fresh one.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib that say nothing to a user; raised as errors, they would stop its threads."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Failure:
    """Scan that could not be worked on, the reason, and the code of the error."""

    scan: ScanFile
    reason: str
    code: str

    def to_dict(self) -> dict[str, str]:
        """Return plain data for JSON."""
        return {"scan": str(self.scan.path), "reason": self.reason, "code": self.code}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Numbers of a run."""

    skipped: int  # Scans that were done already
    failures: tuple[Failure, ...]  # Scans that failed, in order
    done: int  # Scans that were worked on with success
    # Scans left out for want of results to work on, by a stage that looks for them
    missing: MissingResults | None = None
    seconds: float = 0.0  # Time of the work on scans, without the start of the command
    summary: RunSummary | None = None  # Of the scans that were worked on
    # Number of their points that were written as unlabelled for their error, if that was asked
    rejected_points: int | None = None


def run_over_scans(
    task: Task,
    scans: Sequence[ScanFile],
    options: RunOptions,
    *,
    is_done: Callable[[ScanFile], bool] = lambda scan: False,
    on_result: Callable[[Any], object] = lambda result: None,
) -> Outcome:
    """Run a task, which writes results and returns something small, over scans.

    `scans`: the same for every shard; `is_done`: tells of a scan if it has its results; then it is
    skipped, unless overwriting; `on_result`: is given what the task returns, in no particular
    order, in this process.
    """
    start = time.monotonic()
    mine = options.shard.of(scans)
    todo = [scan for scan in mine if options.overwrite or not is_done(scan)]
    failures: list[Failure] = []
    tried: set[ScanFile] = set()
    try:
        with closing(_attempts(task, todo, options)) as attempts:
            for scan, result, error in attempts:
                log.info("%s: %s", scan.name, error or "done")
                if error is None:
                    on_result(result)
                elif options.on_error == "stop":
                    raise error
                else:
                    failures.append(Failure(scan, str(error), error.code))
                tried.add(scan)
                if options.progress:
                    options.progress(len(tried), len(todo))
        if len(tried) < len(todo):
            found, remedy = "not every scan was worked on", "use fewer jobs"
            raise WorkersLost(f"--backend {options.backend}", found, remedy=remedy)
    except WorkersLost as lost:
        for failure in failures:
            log.error("%s", failure.reason)
        left = [scan for scan in todo if scan not in tried and not is_done(scan)]
        names = first_few([scan.name for scan in left])
        found = f"{lost.found}; {len(left)} of {len(todo)} scans are missing: {names}"
        remedy = f"{lost.remedy}; run again for the rest"
        raise WorkersLost(lost.subject, found, lost.expected, remedy) from lost
    failures.sort(key=lambda failure: failure.scan)
    skipped, done = len(mine) - len(todo), len(todo) - len(failures)
    return Outcome(skipped, tuple(failures), done, seconds=time.monotonic() - start)


def _pool(options: RunOptions, scans: int) -> AbstractContextManager[WorkerPool]:
    """Start workers for so many scans, or connect to them, and end that afterwards."""
    if options.backend not in CLUSTERS:
        return local_pool(options, scans)
    from salsanext_cli.parallel import clusters

    return {"dask": clusters.dask_pool, "ray": clusters.ray_pool}[options.backend](options, scans)


def _attempts(
    task: Task, scans: list[ScanFile], options: RunOptions
) -> Generator[Attempt, None, None]:
    """Yield the attempts of all scans, in no particular order where workers make them."""
    if not scans:
        return
    if options.backend not in CLUSTERS and min(len(scans), options.workers_here()) == 1:
        yield from opened(task)(scans)
        return
    stop = options.on_error == "stop"
    with warnings.catch_warnings():
        for message in HARMLESS_WARNINGS:
            warnings.filterwarnings("ignore", message)
        with _pool(options, len(scans)) as pool:
            context = WorkerContext(uuid4().hex, MARK.get(), stop, Path.cwd(), pool.threads)
            attempt = partial(attempt_chunk, context, task)
            try:
                yield from _of_chunks(attempt, chunks(scans, pool.workers), pool, options.backend)
            finally:
                # Joblib kills processes, but cannot kill threads and does not wait for them.
                WORKER.end(context.run)


def _of_chunks(
    attempt: Callable[[Chunk], list[Attempt]],
    cut: Iterable[Chunk],
    pool: WorkerPool,
    backend: str,
) -> Generator[Attempt, None, None]:
    import joblib

    with joblib.parallel_config(**pool.backend):
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, pre_dispatch=pool.in_flight
        )
    try:
        with signals_blocked(signal.SIGINT, signal.SIGTERM) if backend == "loky" else nullcontext():
            found = parallel(joblib.delayed(attempt)(chunk) for chunk in cut)
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
