# SPDX-License-Identifier: MIT
"""Run of a task over many scans, in this process or by workers; failures and summary."""

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from salsanext_cli.core.errors import SalsanextError, WorkersLost
from salsanext_cli.core.measures.filtered_points import FilteredPoints
from salsanext_cli.core.texts import first_few, with_hint
from salsanext_cli.runs.loop.job import Attempt, Task
from salsanext_cli.runs.loop.pipeline import Report, opened
from salsanext_cli.runs.loop.run_options import Progress, RunOptions
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.selection import MissingResults
from salsanext_cli.runs.summary.scan_summary import RunSummary

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
    def of(cls, scan: ScanFile, error: SalsanextError) -> "Failure":
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
    """Numbers of a run.

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
    rejected_points : int, optional
        Number of points that were left unlabelled because of their uncertainty.
    filtered_points : FilteredPoints, optional
        Number of points that passed a filter.
    """

    skipped: int
    failures: tuple[Failure, ...]
    done: int
    missing: MissingResults | None = None
    seconds: float = 0.0
    summary: RunSummary | None = None
    rejected_points: int | None = None
    filtered_points: FilteredPoints | None = None


def run_over_scans(
    task: Task,
    scans: Sequence[ScanFile],
    options: RunOptions,
    *,
    is_done: Callable[[ScanFile], bool] = lambda scan: False,
    on_result: Callable[[Any], object] = lambda result: None,
    summary: RunSummary | None = None,
) -> Outcome:
    """Run a task over the scans of this shard that are not done.

    Parameters
    ----------
    task, scans, options
        Work on each scan, all scans, and workers, shard and treatment of failures.
    is_done, on_result, summary
        Functions of a scan, whether it has results, and of each result; or a summary of results.

    Returns
    -------
    Outcome

    Raises
    ------
    SalsanextError
        If a worker died; or the first failure, if ``options.on_error`` is ``"stop"``.
    """
    on_result = summary.add if summary else on_result
    start = time.monotonic()
    mine = options.shard.of(scans)
    todo = [scan for scan in mine if options.overwrite or not is_done(scan)]
    failures: list[Failure] = []
    tried: set[ScanFile] = set()

    def report(attempt: Attempt[Any]) -> None:
        error = attempt.error
        log.info("%s: %s", attempt.file.name, error.headline if error else "done")
        if error is None or options.on_error == "stop":
            on_result(attempt.get())
        else:
            failures.append(Failure.of(attempt.file, error))
        tried.add(attempt.file)
        if options.progress:
            options.progress(len(tried), len(todo))

    try:
        if todo:
            _work(task, todo, options, report)
    except WorkersLost as lost:
        for failure in failures:
            log.error("%s", failure.text)
        missing = [scan for scan in todo if scan not in tried and not is_done(scan)]
        raise _with_missing(lost, missing, len(todo)) from lost
    return Outcome(
        skipped=len(mine) - len(todo),
        failures=tuple(sorted(failures, key=lambda failure: failure.scan)),
        done=len(tried) - len(failures),
        seconds=time.monotonic() - start,
        summary=summary,
    )


def _with_missing(lost: WorkersLost, missing: Sequence[ScanFile], count: int) -> WorkersLost:
    """Return the error about lost workers with the missing ones of a number of scans."""
    names = first_few([scan.name for scan in missing])
    problem = f"{lost.problem}; {len(missing)} of {count} scans are missing: {names}"
    return WorkersLost(lost.subject, problem, hint=f"{lost.hint}; run again for the rest")


def _work(task: Task, scans: Sequence[ScanFile], options: RunOptions, report: Report) -> None:
    """Report the attempts of all scans, in no particular order if workers make them."""
    if min(len(scans), options.workers()) == 1:
        for _ in opened(task)(scans, report):
            pass
        return
    from salsanext_cli.runs.loop.pool import attempts_of_workers

    with closing(attempts_of_workers(task, scans, options)) as attempts:
        for attempt in attempts:
            report(attempt)
