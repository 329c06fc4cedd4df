# SPDX-License-Identifier: MIT
"""Run one function over many scans: some done already, some in parallel, some failing."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from salsanext_cli.errors import UsageError, WorkersLost
from salsanext_cli.formats.reading import filled
from salsanext_cli.parallel.shards import Shard
from salsanext_cli.parallel.tasks import Attempt, Work, WorkerContext, attempt_each
from salsanext_cli.parallel.threads import worker_count
from salsanext_cli.storage.atomic import sweep
from salsanext_cli.storage.layout import ScanFile

log = logging.getLogger(__name__)

BACKENDS = ("loky", "threading", "dask", "ray")
CLUSTERS = ("dask", "ray")
"""Backends whose workers may be on other machines."""
SHOWN = 3
"""How many of the scans that are missing an error names."""

Result = TypeVar("Result")
Progress = Callable[[int, int], None]
"""Called with the number of scans done and the number of scans to do."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How a stage goes through its scans.

    Attributes
    ----------
    jobs : int, optional
        Workers side by side; -1 is one per core, or all of a cluster. None is one here, and all of
        a cluster.
    on_error : {"skip", "stop"}
        Whether a scan that fails is named at the end or ends the run.
    overwrite : bool
        Whether results that exist are made again.
    progress : callable, optional
        Called after each scan, or for several together when a worker is done with them.
    backend : {"loky", "threading", "dask", "ray"}
        Processes, threads, or the workers of a cluster.
    scheduler : str, optional
        The address of a cluster of Dask or Ray; without one, it is started on this machine.
    shard : Shard
        Which share of the scans, where other runs take the others.
    """

    jobs: int | None = None
    on_error: str = "skip"
    overwrite: bool = False
    progress: Progress | None = None
    backend: str = "loky"
    scheduler: str | None = None
    shard: Shard = Shard()

    def __post_init__(self) -> None:
        worker_count(1 if self.jobs is None else self.jobs)
        if self.on_error not in ("skip", "stop"):
            raise UsageError("--on-error", self.on_error, "skip or stop")
        if self.backend not in BACKENDS:
            raise UsageError("--backend", self.backend, f"one of {', '.join(BACKENDS)}")
        if self.scheduler is not None and self.backend not in CLUSTERS:
            raise UsageError(
                f"--scheduler {self.scheduler}", f"--backend {self.backend}", "dask or ray"
            )

    def workers_here(self) -> int:
        """Return how many workers are wanted on this machine."""
        alone = -1 if self.backend in CLUSTERS else 1
        return worker_count(alone if self.jobs is None else self.jobs)

    def wanted(self) -> int | None:
        """Return how many workers of a cluster are wanted, None for all."""
        return None if self.jobs in (None, -1) else self.jobs


@dataclass(frozen=True, slots=True)
class Failure:
    """A scan that could not be worked on, and why."""

    scan: ScanFile
    reason: str


@dataclass(frozen=True, slots=True)
class Outcome(Generic[Result]):
    """What became of the scans of a run.

    Attributes
    ----------
    results : tuple
        What the function returned for each scan that was done, in no particular order; empty if
        they were handed on.
    skipped : int
        Scans whose results were there already.
    failures : tuple of Failure
        Scans that failed.
    handed_on : int
        Results that were handed on as they came.
    """

    results: tuple[Result, ...]
    skipped: int
    failures: tuple[Failure, ...]
    results_passed_on: int = 0

    @property
    def done(self) -> int:
        """How many scans were worked on with success."""
        return len(self.results) + self.results_passed_on


def run_over_scans(
    work: Callable[[ScanFile], Result],
    scans: Sequence[ScanFile],
    options: RunOptions,
    *,
    is_done: Callable[[ScanFile], bool] = lambda scan: False,
    on_result: Callable[[Result], object] | None = None,
) -> Outcome[Result]:
    """Run a function over scans.

    Parameters
    ----------
    work : callable
        Takes a scan, writes its results, returns something small. With several jobs it is
        pickled, so it should hold settings and load heavy things itself.
    scans : sequence of ScanFile
        What to work on; the same for every shard.
    options : BatchOptions
        Workers, shard, errors, overwriting and progress.
    results_of : callable, optional
        The files that `work` writes for a scan; a scan for which all exist is skipped unless
        overwriting. Without any, no scan is skipped.
    hand_on : callable, optional
        Is given each result as it comes, in no particular order, so that they need not be kept
        until the last; called in this process. Without it they are in the outcome.

    Raises
    ------
    SalsanextError
        The first failure, if `options.on_error` is "stop".
    WorkersLost
        If workers died and scans are missing for that; it says which.
    """
    mine = options.shard.of(scans)
    todo = [s for s in mine if not is_done(s)]
    results: list[Result] = []
    failures: list[Failure] = []
    tried: set[ScanFile] = set()
    take = on_result or results.append
    try:
        with closing(_attempts(work, todo, options, lambda _: ())) as attempts:
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
    except WorkersLost as lost:
        for failure in failures:
            log.error("%s", failure.reason)
        left = [s for s in todo if s not in tried and not is_done(s)]
        raise _missing(lost, left, len(todo)) from lost
    failures.sort(key=lambda failure: (failure.scan.sequence, failure.scan.stem))
    skipped, done = len(mine) - len(todo), len(todo) - len(failures)
    return Outcome(tuple(results), skipped, tuple(failures), done - len(results))


def _exist(paths: Iterable[Path]) -> bool:
    listed = list(paths)
    return bool(listed) and all(filled(path) for path in listed)


def _missing(lost: WorkersLost, left: list[ScanFile], count: int) -> WorkersLost:
    """Say which scans went with their workers."""
    names = ", ".join(f"{scan.sequence}/{scan.stem}" for scan in left[:SHOWN])
    more = f" and {len(left) - SHOWN} more" if len(left) > SHOWN else ""
    return WorkersLost(
        lost.subject,
        f"{lost.found}; {len(left)} of {count} scans are missing: {names}{more}",
        lost.expected,
        f"{lost.remedy}; run again for the rest",
    )


def _attempts(
    work: Work,
    scans: list[ScanFile],
    options: RunOptions,
    results_of: Callable[[ScanFile], Iterable[Path]],
) -> Generator[Attempt, None, None]:
    here = options.backend not in CLUSTERS
    if not scans or (here and min(len(scans), options.workers_here()) == 1):
        yield from attempt_each(work, scans)
        return
    from salsanext_cli.parallel.workers import attempts_of_workers

    mark = uuid.uuid4().hex
    try:
        yield from attempts_of_workers(
            work, scans, options, WorkerContext(mark, options.on_error == "stop")
        )
    finally:
        # Workers are killed when the run ends early, maybe while they write.
        for folder in {path.parent for scan in scans for path in results_of(scan)}:
            sweep(folder, mark)
