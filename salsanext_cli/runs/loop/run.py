# SPDX-License-Identifier: MIT
"""The loop over scans: a task on each scan of a shard that has no results yet.

`run_over_scans` decides which scans are attempted, counts the attempts and handles their failures:
an error of a scan ends the run or is listed in the `Outcome`, by ``options.on_error``. A failed
scan is attempted again only by a further run.

The attempts come from one of three functions. All overlap the three steps of a job by `pipeline`,
which turns the error of a scan into a failed attempt. If a batch of several scans fails, `pipeline`
computes each of them alone, so that one scan does not fail the others; if it did not fit into
memory, the next batches are smaller.

- In this process: `pipeline.opened`.
- By several workers: `pool.attempts_of_workers`, which replaces no dead worker.
- By workers of a cluster: `cluster.attempts.attempts_of_cluster`, which replaces them.

Where the number of workers was not requested, `measured_workers` decides on a GPU between the first
two.
"""

import logging
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

from salsanext_cli.core.errors import SalsanextError, WorkersLost
from salsanext_cli.core.texts import first_few, with_hint
from salsanext_cli.runs.loop.event_file import EventLog, opened_events
from salsanext_cli.runs.loop.job import Attempt, Task
from salsanext_cli.runs.loop.measured_workers import attempts_as_needed, needs_measurement
from salsanext_cli.runs.loop.pipeline import attempt_function, opened_work
from salsanext_cli.runs.loop.run_folders import RunFolders
from salsanext_cli.runs.loop.run_options import Progress, RunOptions
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import MissingResults
from salsanext_cli.runs.summary.run_summary import RunSummary
from salsanext_cli.runs.summary.scan_summary import ScanSummary

__all__ = ["Failure", "Outcome", "Progress", "RunOptions", "run_over_scans"]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """Scan that could not be processed, and the error: message, hint and code."""

    scan: ScanFile
    reason: str
    hint: str
    code: str

    @classmethod
    def from_error(cls, scan: ScanFile, error: SalsanextError) -> "Failure":
        """Return the failure of a scan by an error."""
        return cls(scan=scan, reason=error.headline, hint=error.hint, code=error.code)

    @property
    def text(self) -> str:
        """The message, and a line for the hint."""
        return with_hint(self.reason, self.hint)

    def to_dict(self) -> dict[str, str]:
        """Return plain data for JSON."""
        scan = str(self.scan.path)
        return {"scan": scan, "reason": self.reason, "hint": self.hint, "code": self.code}


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Numbers of a run. Stages with further numbers have records of their own.

    Attributes
    ----------
    skipped, done : int
        Number of scans with complete results before the run, and of scans that succeeded in it.
    failures : tuple of Failure
        Scans that failed, in order.
    missing : MissingResults, optional
        Scans without the results that the stage needs.
    seconds : float
        Duration of the work on scans.
    summary : RunSummary, optional
        Summary of the scans.
    workers : int
        Number of workers, if it was chosen by measurement; else 0.
    """

    skipped: int
    failures: tuple[Failure, ...]
    done: int
    missing: MissingResults | None = None
    seconds: float = 0.0
    summary: RunSummary | None = None
    workers: int = 0

    @classmethod
    def from_run(cls, outcome: "Outcome", **numbers: Any) -> Self:
        """Return the numbers of a run with those that only its stage has, by name."""
        common = {field.name: getattr(outcome, field.name) for field in fields(Outcome)}
        return cls(**common | numbers)

    @property
    def has_results(self) -> bool:
        """Whether any scan of the run has results."""
        return self.done + self.skipped > 0


@dataclass(slots=True, kw_only=True)
class RunningCount:
    """Attempts of a run so far."""

    options: RunOptions
    scans: int  # Number of scans to attempt
    # Scans without an attempt. Those of attempts are copies from workers, which would stay.
    unattempted: set[ScanFile]
    on_result: Callable[[Any], object]
    events: EventLog
    failures: list[Failure] = field(default_factory=list)
    workers: int = 0  # As of `Outcome`

    @property
    def attempted(self) -> int:
        """Number of attempted scans."""
        return self.scans - len(self.unattempted)

    def use_workers(self, count: int) -> None:
        """Note the number of workers that was chosen by measurement."""
        self.workers = count

    def add(self, attempt: Attempt[Any]) -> None:
        """Count an attempt, hand its result over, and show the progress."""
        scan = attempt.file
        error = attempt.error
        log.info("%s: %s", scan.name, error.headline if error else "done")
        result = attempt.result
        codes = result.warning_codes if isinstance(result, ScanSummary) else ()
        self.events.add(scan, error, codes)
        if error is None:
            self.on_result(attempt.get())
        elif self.options.on_error == "stop":
            raise error
        else:
            self.failures.append(Failure.from_error(scan, error))
        self.unattempted.discard(scan)
        if self.options.progress:
            self.options.progress(self.attempted, self.scans)


def run_over_scans(
    task: Task,
    scans: Sequence[ScanFile],
    options: RunOptions,
    *,
    is_done: Callable[[ScanFile], bool] = lambda scan: False,
    on_result: Callable[[Any], object] = lambda result: None,
    summary: RunSummary | None = None,
    writes: Sequence[Path] = (),
    reads: Sequence[Path] = (),
) -> Outcome:
    """Run a task over the scans of this shard that are not done.

    Parameters
    ----------
    task : callable
        Work on each scan.
    scans : sequence of ScanFile
        All scans.
    options : RunOptions
        Workers, shard and treatment of failures.
    is_done : callable
        Function of a scan that returns whether it has its results.
    on_result : callable
        Function of each result, which is called in this thread.
    summary : RunSummary, optional
        Summary to which the results are added, instead of `on_result`.
    writes : sequence of Path, optional
        Folders that the task writes into, which all nodes of a cluster must share.
    reads : sequence of Path, optional
        Folders whose results the task reads, which all nodes must share, too.

    Returns
    -------
    Outcome

    Raises
    ------
    WorkersLost
        If a worker died, or the cluster is lost.
    SalsanextError
        The first failure, if ``options.on_error`` is ``"stop"``.
    """
    start = time.monotonic()
    scans_of_shard = options.shard.select(scans)
    todo = [scan for scan in scans_of_shard if options.overwrite or not is_done(scan)]
    if todo and options.progress:
        options.progress(0, len(todo))
    with opened_events(options.events, len(todo)) as events:
        count = RunningCount(
            options=options,
            scans=len(todo),
            unattempted=set(todo),
            on_result=summary.add if summary else on_result,
            events=events,
        )
        folders = RunFolders(writes=tuple(writes), reads=tuple(reads))
        _run(task, todo, count, is_done, folders)
    return Outcome(
        skipped=len(scans_of_shard) - len(todo),
        failures=tuple(sorted(count.failures, key=lambda failure: failure.scan)),
        done=count.attempted - len(count.failures),
        seconds=time.monotonic() - start,
        summary=summary,
        workers=count.workers,
    )


def _run(
    task: Task,
    todo: Sequence[ScanFile],
    count: RunningCount,
    is_done: Callable[[ScanFile], bool],
    folders: RunFolders,
) -> None:
    """Attempt all scans, and count the attempts; arguments as of `run_over_scans`."""
    if not todo:
        return
    try:
        with closing(_attempts(task, todo, count, folders)) as attempts:
            for attempt in attempts:
                count.add(attempt)
    except WorkersLost as lost:
        for failure in count.failures:
            log.error("%s", failure.text)
        missing = [scan for scan in todo if scan in count.unattempted and not is_done(scan)]
        raise _with_missing(lost, missing, len(todo)) from lost


def _attempts(
    task: Task, scans: Sequence[ScanFile], count: RunningCount, folders: RunFolders
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts of all scans, in no particular order if workers make them.

    `count`: of the run, to which attempts are added that the end of the run keeps from being
    yielded.
    """
    options = count.options
    if options.cluster is not None:
        from salsanext_cli.runs.loop.cluster.attempts import attempts_of_cluster

        return attempts_of_cluster(task, scans, options, folders)
    if min(len(scans), options.workers()) == 1:
        work = opened_work(task)
        if needs_measurement(work, scans, options):
            return attempts_as_needed(task, work, scans, options, count.add, count.use_workers)
        return attempt_function(work)(scans, count.add)
    from salsanext_cli.runs.loop.pool import attempts_of_workers

    return attempts_of_workers(task, scans, options)


def _with_missing(lost: WorkersLost, missing: Sequence[ScanFile], count: int) -> WorkersLost:
    """Return the error about lost workers, with the scans of `count` that are missing."""
    names = first_few([scan.name for scan in missing])
    problem = f"{lost.problem}; {len(missing)} of {count} scans are missing: {names}"
    hints = filter(None, [lost.hint, "run again for the rest"])
    return WorkersLost(lost.subject, problem, hint="; ".join(hints))
