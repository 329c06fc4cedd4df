# SPDX-License-Identifier: MIT
"""Run of a task over many scans: which of them, here or by workers, failures and summary."""

import logging
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from salsanext_cli.errors import SalsanextError, WorkersLost, first_few, with_hint
from salsanext_cli.measures.scan_summary import RunSummary
from salsanext_cli.parallel.job import Attempt, Task
from salsanext_cli.parallel.run_options import Progress, RunOptions
from salsanext_cli.parallel.worker import opened
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.results.selection import MissingResults

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
    # Number of their points, and of those among them that a stage kept that leaves some out
    kept_points: tuple[int, int] | None = None


def run_over_scans(
    task: Task,
    scans: Sequence[ScanFile],
    options: RunOptions,
    *,
    is_done: Callable[[ScanFile], bool] = lambda scan: False,
    on_result: Callable[[Any], object] = lambda result: None,
    summary: RunSummary | None = None,
) -> Outcome:
    """Run a task over this shard's scans that are not done; results go to `on_result`, here.

    `summary`: takes the results, which are numbers about each scan, in its place.
    """
    on_result = summary.add if summary else on_result
    start = time.monotonic()
    mine = options.shard.of(scans)
    todo = [scan for scan in mine if options.overwrite or not is_done(scan)]
    failures: list[Failure] = []
    tried: set[ScanFile] = set()
    try:
        with closing(_attempts(task, todo, options)) as attempts:
            for attempt in attempts:
                scan, error = attempt.file, attempt.error
                log.info("%s: %s", scan.name, error.headline if error else "done")
                if error is None or options.on_error == "stop":
                    on_result(attempt.get())
                else:
                    failures.append(Failure.of(scan, error))
                tried.add(scan)
                if options.progress:
                    options.progress(len(tried), len(todo))
        if len(tried) < len(todo):
            found, hint = "not every scan was worked on", "use fewer jobs"
            raise WorkersLost(f"--backend {options.backend}", found, hint=hint)
    except WorkersLost as lost:
        for failure in failures:
            log.error("%s", failure.text)
        left = [scan for scan in todo if scan not in tried and not is_done(scan)]
        names = first_few([scan.name for scan in left])
        found = f"{lost.problem}; {len(left)} of {len(todo)} scans are missing: {names}"
        hint = f"{lost.hint}; run again for the rest"
        raise WorkersLost(lost.subject, found, lost.expected, hint) from lost
    failures.sort(key=lambda failure: failure.scan)
    skipped, done = len(mine) - len(todo), len(todo) - len(failures)
    seconds = time.monotonic() - start
    return Outcome(skipped, tuple(failures), done, seconds=seconds, summary=summary)


def _attempts(
    task: Task, scans: Sequence[ScanFile], options: RunOptions
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts of all scans, in no particular order where workers make them."""
    if not scans:
        return
    if options.backend != "dask" and min(len(scans), options.workers_here()) == 1:
        yield from opened(task)(scans)
        return
    from salsanext_cli.parallel.pool import attempts_of_workers

    yield from attempts_of_workers(task, scans, options)
