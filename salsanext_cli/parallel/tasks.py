# SPDX-License-Identifier: MIT
"""Tasks: what a run does to each scan, and what comes of it."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Protocol, runtime_checkable

from salsanext_cli.errors import SalsanextError
from salsanext_cli.storage.layout import ScanFile

Attempt = tuple[ScanFile, Any, SalsanextError | None]
"""A scan, its result, and the error if there is none."""
AttemptFunction = Callable[[Iterable[ScanFile]], Iterator[Attempt]]
"""Works on scans in turn; a scan that fails is an attempt with an error."""


@runtime_checkable
class OpenableTask(Protocol):
    """Task that is opened once per worker, since that is slow: it loads a network, say."""

    def open(self) -> AttemptFunction:
        """Load what all scans need, and return the function that works on them."""


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
