# SPDX-License-Identifier: MIT
"""Run one function over many scans: some done already, some in parallel, some failing."""

from __future__ import annotations

import logging
import os
import signal
import uuid
import warnings
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Generic, TypeVar

from salsanext_cli.errors import SalsanextError, UsageError
from salsanext_cli.formats.atomic import MARK, sweep
from salsanext_cli.formats.layout import ScanFile
from salsanext_cli.formats.reading import filled

log = logging.getLogger(__name__)

HARMLESS = (
    # Who stops a run knows that it has been stopped.
    ".*tasks which were still being processed",
    # A worker that grows, as it does when it loads a network, is replaced by a fresh one.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib that say nothing to a user; raised as errors, they would stop its threads."""

Result = TypeVar("Result")
Progress = Callable[[int, int], None]
"""Called with the number of scans done and the number of scans to do."""


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """How a stage goes through its scans.

    Attributes
    ----------
    jobs : int
        Processes that work side by side; -1 is one per core.
    on_error : {"skip", "stop"}
        Whether a scan that fails is named at the end or ends the run.
    overwrite : bool
        Whether results that exist are made again.
    progress : callable, optional
        Called after each scan.
    """

    jobs: int = 1
    on_error: str = "skip"
    overwrite: bool = False
    progress: Progress | None = None

    def __post_init__(self) -> None:
        worker_count(self.jobs)
        if self.on_error not in ("skip", "stop"):
            raise UsageError("--on-error", self.on_error, "skip or stop")


def worker_count(jobs: int) -> int:
    """Return how many processes `--jobs` asks for; -1 is one per core."""
    if jobs == 0 or jobs < -1:
        raise UsageError("--jobs", str(jobs), "a number of processes, or -1 for all cores")
    return os.cpu_count() or 1 if jobs == -1 else jobs


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
    handed_on: int = 0

    @property
    def done(self) -> int:
        """How many scans were worked on with success."""
        return len(self.results) + self.handed_on


def run_batch(
    work: Callable[[ScanFile], Result],
    scans: Sequence[ScanFile],
    options: BatchOptions,
    results_of: Callable[[ScanFile], Iterable[Path]] = lambda _: (),
    hand_on: Callable[[Result], object] | None = None,
) -> Outcome[Result]:
    """Run a function over scans.

    Parameters
    ----------
    work : callable
        Takes a scan, writes its results, returns something small. With several jobs it is
        pickled, so it should hold settings and load heavy things itself.
    scans : sequence of ScanFile
        What to work on.
    options : BatchOptions
        Jobs, errors, overwriting and progress.
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
    """
    todo = [s for s in scans if options.overwrite or not _exist(results_of(s))]
    results: list[Result] = []
    failures: list[Failure] = []
    take = hand_on or results.append
    with closing(_attempts(work, todo, options.jobs, results_of)) as attempts:
        for number, (scan, result, error) in enumerate(attempts, start=1):
            log.info("%s/%s: %s", scan.sequence, scan.stem, error or "done")
            if error is None:
                take(result)
            elif options.on_error == "stop":
                raise error
            else:
                failures.append(Failure(scan, str(error)))
            if options.progress:
                options.progress(number, len(todo))
    failures.sort(key=lambda failure: (failure.scan.sequence, failure.scan.stem))
    skipped, done = len(scans) - len(todo), len(todo) - len(failures)
    return Outcome(tuple(results), skipped, tuple(failures), done - len(results))


def _exist(paths: Iterable[Path]) -> bool:
    listed = list(paths)
    return bool(listed) and all(filled(path) for path in listed)


Attempt = tuple[ScanFile, Any, SalsanextError | None]


def _attempts(
    work: Callable[[ScanFile], Any],
    scans: list[ScanFile],
    jobs: int,
    results_of: Callable[[ScanFile], Iterable[Path]],
) -> Generator[Attempt, None, None]:
    workers = min(len(scans), worker_count(jobs))
    if workers <= 1:
        yield from (_attempt(work, scan) for scan in scans)
        return
    mark = uuid.uuid4().hex
    try:
        yield from _attempts_of_workers(work, scans, workers, mark)
    finally:
        # Workers are killed when the run ends early, maybe while they write.
        for folder in {path.parent for scan in scans for path in results_of(scan)}:
            sweep(folder, mark)


def _attempts_of_workers(
    work: Callable[[ScanFile], Any], scans: list[ScanFile], workers: int, mark: str
) -> Generator[Attempt, None, None]:
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    threads = max(1, (os.cpu_count() or 1) // workers)
    here = Path.cwd()
    with (
        joblib.parallel_config("loky", n_jobs=workers, inner_max_num_threads=threads),
        warnings.catch_warnings(),
    ):
        for harmless in HARMLESS:
            warnings.filterwarnings("ignore", harmless)
        parallel = joblib.Parallel(return_as="generator_unordered")
        try:
            with _deaf_to_interrupts():
                attempts = parallel(joblib.delayed(_attempt_in)(here, mark, work, s) for s in scans)
            yield from attempts
        except TerminatedWorkerError as error:
            raise SalsanextError(
                f"--jobs {workers}",
                "the system ended a process",
                "memory for all of them",
                "use fewer jobs",
            ) from error


@contextmanager
def _deaf_to_interrupts() -> Generator[None, None, None]:
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


def _attempt_in(
    folder: Path, mark: str, work: Callable[[ScanFile], Any], scan: ScanFile
) -> Attempt:
    """Attempt in a worker, which may be an old one that was started in another folder."""
    os.chdir(folder)
    MARK.set(mark)
    return _attempt(work, scan)


def _attempt(work: Callable[[ScanFile], Any], scan: ScanFile) -> Attempt:
    try:
        return scan, work(scan), None
    except SalsanextError as error:
        return scan, None, error
