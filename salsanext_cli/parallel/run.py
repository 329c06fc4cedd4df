# SPDX-License-Identifier: MIT
"""Run of one task over many scans: some done already, some in parallel, some failing."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar
from uuid import uuid4

from salsanext_cli.errors import WorkersLost
from salsanext_cli.parallel.options import CLUSTERS, Progress, RunOptions
from salsanext_cli.parallel.tasks import Attempt, OpenableTask, opened
from salsanext_cli.parallel.worker import WorkerContext
from salsanext_cli.storage.atomic import MARK
from salsanext_cli.storage.layout import ScanFile

__all__ = ["Failure", "Outcome", "Progress", "RunOptions", "run_over_scans"]

MAX_SCANS_SHOWN = 3
"""Missing scans that an error names."""

Result = TypeVar("Result")
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Failure:
    """Scan that could not be worked on, and the reason."""

    scan: ScanFile
    reason: str


@dataclass(frozen=True, slots=True)
class Outcome(Generic[Result]):
    """Numbers and results of a run.

    Attributes
    ----------
    results : tuple
        Results of the task in no particular order; empty if they were passed on.
    skipped : int
        Scans that were done already.
    failures : tuple of Failure
        Scans that failed, in order.
    done : int
        Scans that were worked on with success.
    """

    results: tuple[Result, ...]
    skipped: int
    failures: tuple[Failure, ...]
    done: int


def run_over_scans(
    task: Callable[[ScanFile], Result] | OpenableTask,
    scans: Sequence[ScanFile],
    options: RunOptions,
    *,
    is_done: Callable[[ScanFile], bool] = lambda scan: False,
    on_result: Callable[[Result], object] | None = None,
) -> Outcome[Result]:
    """Run a task over scans.

    Parameters
    ----------
    task : callable or OpenableTask
        Works on a scan, writes its results, returns something small. With several jobs it is
        pickled.
    scans : sequence of ScanFile
        Scans to work on; the same for every shard.
    options : RunOptions
        Workers, shard, errors, overwriting and progress.
    is_done : callable, optional
        Tells of a scan if it has its results; then it is skipped, unless overwriting.
    on_result : callable, optional
        Is given each result as it comes, in no particular order, so that they need not be kept
        until the last; called in this process. Without it they are in the outcome.

    Raises
    ------
    SalsanextError
        The first failure, if `options.on_error` is "stop".
    WorkersLost
        If a worker died; it says which scans are missing for that.
    """
    mine = options.shard.of(scans)
    todo = [scan for scan in mine if options.overwrite or not is_done(scan)]
    results: list[Result] = []
    failures: list[Failure] = []
    tried: set[ScanFile] = set()
    take = on_result or results.append
    try:
        with closing(_attempts(task, todo, options)) as attempts:
            for scan, result, error in attempts:
                log.info("%s/%s: %s", scan.sequence, scan.stem, error or "done")
                if error is None:
                    take(result)
                elif options.on_error == "stop":
                    raise error
                else:
                    failures.append(Failure(scan, str(error)))
                tried.add(scan)
                if options.progress:
                    options.progress(len(tried), len(todo))
        if len(tried) < len(todo):
            raise WorkersLost(
                f"--backend {options.backend}",
                "not every scan was worked on",
                remedy="use fewer jobs",
            )
    except WorkersLost as lost:
        for failure in failures:
            log.error("%s", failure.reason)
        left = [scan for scan in todo if scan not in tried and not is_done(scan)]
        names = ", ".join(f"{scan.sequence}/{scan.stem}" for scan in left[:MAX_SCANS_SHOWN])
        more = f" and {len(left) - MAX_SCANS_SHOWN} more" if len(left) > MAX_SCANS_SHOWN else ""
        found = f"{lost.found}; {len(left)} of {len(todo)} scans are missing: {names}{more}"
        remedy = f"{lost.remedy}; run again for the rest"
        raise WorkersLost(lost.subject, found, lost.expected, remedy) from lost
    failures.sort(key=lambda failure: (failure.scan.sequence, failure.scan.stem))
    skipped, done = len(mine) - len(todo), len(todo) - len(failures)
    return Outcome(tuple(results), skipped, tuple(failures), done)


def _attempts(
    task: Callable[[ScanFile], Result] | OpenableTask, scans: list[ScanFile], options: RunOptions
) -> Generator[Attempt, None, None]:
    if not scans:
        return
    if options.backend not in CLUSTERS and min(len(scans), options.workers_here()) == 1:
        yield from opened(task)(scans)
        return
    from salsanext_cli.parallel.attempts import attempts_of_workers

    stop = options.on_error == "stop"
    context = WorkerContext(uuid4().hex, MARK.get(), stop, Path.cwd())
    yield from attempts_of_workers(task, scans, options, context)
