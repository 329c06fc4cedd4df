# SPDX-License-Identifier: MIT
"""One worker of a run: the task that it has opened, the chunks that it works on, and its GPU."""

import getpass
import hashlib
import logging
import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import MARK
from salsanext_cli.parallel.job import Attempt, OpenableTask, ScanJob, Task
from salsanext_cli.parallel.pipeline import Pipeline, one_by_one
from salsanext_cli.parallel.run_options import use_threads
from salsanext_cli.results.paths import ScanFile

POLL_INTERVAL_S = 1.0
THREAD_TIMEOUT_S = 10.0

Chunk = tuple[ScanFile, ...]  # Scans that a worker is sent together
AttemptFunction = Callable[[Iterable[ScanFile]], Iterator[Attempt[Any]]]  # Works on scans in turn

log = logging.getLogger(__name__)


def opened(task: Task) -> AttemptFunction:
    """Open a task, and return what works on the scans of a chunk."""
    begin = task.open() if isinstance(task, OpenableTask) else lambda: task

    def attempts(files: Iterable[ScanFile]) -> Iterator[Attempt[Any]]:
        work = begin()
        work = Pipeline(work) if isinstance(work, ScanJob) else work
        return work.run(files) if isinstance(work, Pipeline) else one_by_one(work, files)

    return attempts


def end_with_parent(parent: int) -> None:
    """End this process within seconds of its parent, a process id, which may be killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_INTERVAL_S)
        os._exit(1)  # noqa: TID251

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """Context that a worker needs besides the task."""

    run: str  # Identifies the run: a worker may be an old one that served other runs before
    mark: str  # Start of the names of temporary files
    stop: bool  # The first failure ends the chunk
    folder: Path  # Working folder, from which relative names start
    threads: int  # Threads that each worker may use


class Worker:
    """State of a process that works on chunks: `run`, which it serves, and the last it `ended`."""

    def __init__(self) -> None:
        self.run = self.ended = ""
        self._attempts: AttemptFunction | None = None
        self._busy = 0
        self._threads: set[threading.Thread] = set()
        self._changed = threading.Condition()

    @contextmanager
    def serving(self, context: WorkerContext, task: Task) -> Iterator[AttemptFunction]:
        """Give the opened task of a run, in its folder; all threads serve one run at a time."""
        with self._changed:
            self._changed.wait_for(lambda: self.run == context.run or not self._busy)
            attempts = self._opened(context, task)
            self._busy += 1
            self._threads.add(threading.current_thread())
        try:
            yield attempts
        finally:
            with self._changed:
                self._busy -= 1
                self._changed.notify_all()

    def _opened(self, context: WorkerContext, task: Task) -> AttemptFunction:
        if context.run == self.ended:
            return lambda _: iter(())
        if self._attempts is None or self.run != context.run:
            self._attempts = None
            try:
                os.chdir(context.folder)
            except OSError as error:
                found = f"no such folder on {socket.gethostname()}"
                expected, hint = "folders that all machines share", "start the run in one of them"
                raise OutputError(context.folder, found, expected, hint) from error
            self.run = context.run
            self._attempts = opened(task)
        return self._attempts

    def end(self, run: str) -> None:
        """End a run: wait for its threads, as tensors must not be freed while Python shuts down."""
        with self._changed:
            self.ended = run
            if self.run != run:
                return
            self._changed.wait_for(lambda: not self._busy)
            self.run, self._attempts = "", None
            threads, self._threads = self._threads, set()
        for thread in threads:
            thread.join(THREAD_TIMEOUT_S)


WORKER = Worker()


def attempt_chunk(context: WorkerContext, task: Task, scans: Chunk) -> list[Attempt[Any]]:
    """Attempt the scans of a chunk, in a worker."""
    MARK.set(context.mark)
    use_threads(context.threads)
    done: list[Attempt[Any]] = []
    with WORKER.serving(context, task) as attempts:
        for attempt in attempts(scans):
            done.append(attempt)
            if WORKER.ended == context.run or (context.stop and attempt.error):
                break
    return done


def own_device(device: str, gpus: int) -> str:
    """Return the device: in a worker, "auto" and "cuda" become a GPU of its own, or shared."""
    if not WORKER.run or device not in ("auto", "cuda") or gpus < 2:
        return device
    return f"cuda:{_worker_number()[0] % gpus}"


@cache
def _worker_number() -> tuple[int, object]:
    """Take the lowest number that no live worker of this machine holds, and the lock on it."""
    from filelock import FileLock, Timeout

    try:
        folder, number = _folder_of_numbers(), 0
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        while True:
            lock = FileLock(folder / str(number))
            try:
                lock.acquire(timeout=0)
            except Timeout:
                number += 1
            else:
                return number, lock
    except (OSError, NotImplementedError) as error:
        log.warning("GPUs are shared by chance, since workers cannot be counted: %s", error)
        return os.getpid(), None


def _folder_of_numbers() -> Path:
    """Return a folder of this user's; processes that see other GPUs are counted apart."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    digest = hashlib.sha256(visible.encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"salsanext-gpus-{getpass.getuser()}-{digest}"
