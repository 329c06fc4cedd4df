# SPDX-License-Identifier: MIT
"""One worker of a run: the task that it has opened, and the chunks of scans."""

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.files.atomic import MARK
from salsanext_cli.parallel.job import Attempt, Task
from salsanext_cli.parallel.pipeline import AttemptFunction, opened
from salsanext_cli.parallel.run_options import use_threads
from salsanext_cli.results.paths import ScanFile

POLL_INTERVAL_S = 1.0

Chunk = tuple[ScanFile, ...]  # Scans that a worker is sent together
_OPENED: dict[str, AttemptFunction] = {}  # Task of this process, by the run that it serves


def end_with_parent(parent: int) -> None:
    """End this process within seconds of its parent, a process id, which may be killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_INTERVAL_S)
        os._exit(1)  # noqa: TID251

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """Context of a worker."""

    run: str  # Identifier of the run: a process serves several runs
    mark: str  # Start of the names of temporary files
    stop: bool  # Whether the first failure ends the chunk
    folder: Path  # Working folder, from which relative names start
    threads: int  # Threads that each worker may use


def attempt_chunk(context: WorkerContext, task: Task, scans: Chunk) -> list[Attempt[Any]]:
    """Attempt the scans of a chunk, in a worker process."""
    MARK.set(context.mark)
    use_threads(context.threads)
    if context.run not in _OPENED:
        _OPENED.clear()
        os.chdir(context.folder)
        _OPENED[context.run] = opened(task)
    return attempts_of_chunk(_OPENED[context.run], scans, lambda: False, stop=context.stop)


def attempts_of_chunk(
    attempts: AttemptFunction, scans: Chunk, is_stopping: Callable[[], bool], *, stop: bool
) -> list[Attempt[Any]]:
    """Attempt the scans of a chunk, until the run is stopping or, if `stop`, one fails."""
    done: list[Attempt[Any]] = []
    for attempt in attempts(scans, lambda _: None):
        done.append(attempt)
        if is_stopping() or (stop and attempt.error):
            break
    return done
