# SPDX-License-Identifier: MIT
"""Tasks: what a run does to each scan, and what comes of it."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from functools import partial
from typing import Any, Protocol, runtime_checkable

from salsanext_cli.errors import SalsanextError
from salsanext_cli.results.layout import ScanFile

Attempt = tuple[ScanFile, Any, SalsanextError | None]
"""A scan, its result, and the error if there is none."""
AttemptFunction = Callable[[Iterable[ScanFile]], Iterator[Attempt]]
"""Works on scans in turn; a scan that fails is an attempt with an error."""


@runtime_checkable
class OpenableTask(Protocol):
    """Task that is opened once per worker, since that is slow: it loads a network, say."""

    def open(self) -> AttemptFunction:
        """Load what all scans need, and return the function that works on them."""


Steps = Iterator[Any]
"""Work on a scan: yields when the scan is read, when its results are computed, and the result."""

Task = Callable[[ScanFile], Any] | OpenableTask
"""Plain function of one scan, or a task that is opened first; both can be pickled."""


def opened(task: Task) -> AttemptFunction:
    """Open a task, or make attempts of a plain function."""
    return task.open() if isinstance(task, OpenableTask) else partial(one_by_one, task)


def one_by_one(function: Callable[[ScanFile], Any], files: Iterable[ScanFile]) -> Iterator[Attempt]:
    """Call a function with one scan after the other."""
    for file in files:
        try:
            yield file, function(file), None
        except SalsanextError as error:
            yield file, None, error


def overlapping(begin: Callable[[ScanFile], Steps], files: Iterable[ScanFile]) -> Iterator[Attempt]:
    """Attempt scans in order; while one is computed, a thread writes the last and reads the next.

    `begin`: returns the steps of a scan, of which the second is done in this thread.
    """
    pool = ThreadPoolExecutor(1, "salsanext-files")
    waiting = iter(files)

    def step(file: ScanFile, steps: Steps) -> Attempt:
        try:
            return file, next(steps), None
        except SalsanextError as error:
            return file, None, error

    def beside(file: ScanFile, steps: Steps) -> Future[Attempt]:
        return pool.submit(copy_context().run, step, file, steps)

    def read_next() -> tuple[Steps, Future[Attempt]] | None:
        if (file := next(waiting, None)) is None:
            return None
        steps = begin(file)
        return steps, beside(file, steps)

    try:
        ahead, last = read_next(), None
        while ahead:
            steps, reading = ahead
            try:
                file, _, error = reading.result()
                ahead = read_next()
                if error is None:
                    file, _, error = step(file, steps)
            except Exception:
                # A bug at this scan comes after what has become of the one before.
                if last:
                    yield last.result()
                raise
            except BaseException:
                # No error may hide an interrupt, but the scan before may have its results.
                if last and last.exception() is None and last.result()[2] is None:
                    yield last.result()
                raise
            if last:
                yield last.result()
            if error is None:
                last = beside(file, steps)
            else:
                last = Future()
                last.set_result((file, None, error))
        if last:
            yield last.result()
    finally:
        pool.shutdown(cancel_futures=True)
