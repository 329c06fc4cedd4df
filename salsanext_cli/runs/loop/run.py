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


@dataclass(frozen=True, slots=True)
class Failure:
    """Scan that could not be processed, and the error: message, hint and code."""

    scan: ScanFile
    reason: str
    hint: str
    code: str

    @classmethod
    def of(cls, scan: ScanFile, error: SalsanextError) -> "Failure":
        """Return the failure of a scan by an error."""
        return cls(scan, error.headline, error.hint, error.code)

    @property
    def text(self) -> str:
        """The message, and a line for the hint."""
        return with_hint(self.reason, self.hint)

    def to_dict(self) -> dict[str, str]:
        """Return plain data for JSON."""
        scan = str(self.scan.path)
        return {"scan": scan, "reason": self.reason, "hint": self.hint, "code": self.code}


@dataclass(frozen=True, slots=True)
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
    is_done, on_result : callable
        Functions of a scan, whether it has results, and of each result; called in this thread.
    summary : RunSummary, optional
        Summary to which the results are added, instead of `on_result`.

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
        scan, error = attempt.file, attempt.error
        log.info("%s: %s", scan.name, error.headline if error else "done")
        if error is None or options.on_error == "stop":
            on_result(attempt.get())
        else:
            failures.append(Failure.of(scan, error))
        tried.add(scan)
        if options.progress:
            options.progress(len(tried), len(todo))

    try:
        if todo:
            _work(task, todo, options, report)
    except WorkersLost as lost:
        for failure in failures:
            log.error("%s", failure.text)
        names = [scan.name for scan in todo if scan not in tried and not is_done(scan)]
        missing = f"{len(names)} of {len(todo)} scans are missing: {first_few(names)}"
        hint = f"{lost.hint}; run again for the rest"
        raise WorkersLost(lost.subject, f"{lost.problem}; {missing}", hint=hint) from lost
    failures.sort(key=lambda failure: failure.scan)
    skipped, done = len(mine) - len(todo), len(tried) - len(failures)
    return Outcome(skipped, tuple(failures), done, None, time.monotonic() - start, summary)


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
