# SPDX-License-Identifier: MIT
"""Work on the scans of a chunk, in a worker or in this process."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from salsanext_cli.errors import OutputError, SalsanextError
from salsanext_cli.parallel.chunks import Chunk
from salsanext_cli.parallel.devices import ONE_EACH
from salsanext_cli.parallel.threads import use_threads
from salsanext_cli.storage.atomic import MARK
from salsanext_cli.storage.layout import ScanFile

Work = Callable[[ScanFile], Any]
Attempt = tuple[ScanFile, Any, SalsanextError | None]
"""A scan, what came of it, and why nothing did."""


@runtime_checkable
class TakesSeveral(Protocol):
    """Work that goes through scans by itself, maybe several at a time."""

    def attempts(self, files: Iterable[ScanFile]) -> Iterator[Attempt]:
        """Attempt scans; a failure is an attempt without a result."""


def attempt_each(work: Work, scans: Iterable[ScanFile]) -> Iterator[Attempt]:
    """Work on scans, one by one unless the work knows better."""
    return work.open()(scans) if hasattr(work, "open") else one_by_one(work, scans)


def one_by_one(work: Work, scans: Iterable[ScanFile]) -> Iterator[Attempt]:
    """Work on scans one after the other."""
    for scan in scans:
        try:
            yield scan, work(scan), None
        except SalsanextError as error:
            yield scan, None, error


def never() -> bool:
    """Say that the run goes on, where its end comes by other means."""
    return False


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """What a worker is told besides the work.

    Attributes
    ----------
    mark : str
        What begins the names of its temporary files.
    stop : bool
        Whether the first failure ends the chunk.
    folder : Path, optional
        What relative names start from; a thread is there already.
    threads : int, optional
        How many each worker may use; None where that is arranged already.
    ended : callable
        Says whether the run is over, so that a worker that cannot be killed leaves the rest.
    """

    mark: str
    stop: bool
    folder: Path | None = None
    threads: int | None = None
    ended: Callable[[], bool] = never


def attempt_chunk(context: WorkerContext, work: Work, scans: Chunk) -> list[Attempt]:
    """Attempt a chunk in a worker, which may be an old one that served other runs before."""
    MARK.set(context.mark)
    ONE_EACH.set(True)
    if context.threads:
        use_threads(context.threads)
    found: list[Attempt] = []
    with _working_in(context.folder):
        if context.ended():
            return found
        for attempt in attempt_each(work, scans):
            found.append(attempt)
            if context.ended() or (context.stop and attempt[2]):
                break
    return found


class _Users:
    """How many chunks rely on the folder that this process is in: all its threads share it."""

    lock = threading.Lock()
    count = 0


@contextmanager
def _working_in(folder: Path | None) -> Iterator[None]:
    """Go to the folder that the run was started in.

    Raises
    ------
    OutputError
        If this machine has no such folder, or another run of this process needs another one.
    """
    if folder is None:
        yield
        return
    with _Users.lock:
        if _Users.count and not Path.cwd().samefile(folder):
            raise OutputError(folder, "a worker serves runs from two folders", "one thread each")
        try:
            os.chdir(folder)
        except OSError as error:
            raise OutputError(
                folder,
                f"no such folder on {socket.gethostname()}",
                "folders that all machines share",
                "start the run in one of them",
            ) from error
        _Users.count += 1
    try:
        yield
    finally:
        with _Users.lock:
            _Users.count -= 1
