# SPDX-License-Identifier: MIT
"""Workers of a run: attempts at the scans of a chunk, and a GPU for each worker."""

import getpass
import hashlib
import logging
import os
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import MARK
from salsanext_cli.parallel.options import use_threads
from salsanext_cli.parallel.shards import Chunk
from salsanext_cli.parallel.tasks import Attempt, AttemptFunction, Task, opened

THREAD_TIMEOUT_S = 10.0
"""Time for an idle thread of joblib's to end."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class WorkerContext:
    """Context that a worker needs besides the task."""

    run: str  # Identifies the run: a worker may be an old one that served other runs before
    mark: str  # Start of the names of temporary files
    stop: bool  # The first failure ends the chunk
    folder: Path  # Working folder, from which relative names start
    threads: int  # Threads that each worker may use


class Worker:
    """State of a process that works on chunks.

    `run`, `ended`: the run that it works for, empty where it works for none, and the last one that
    it ended; `slot`: number of this process among the workers of its machine, once needed, and the
    lock on it.
    """

    def __init__(self) -> None:
        self.run = self.ended = ""
        self.slot: tuple[int, object] | None = None
        self._attempts: AttemptFunction | None = None
        self._busy = 0
        self._threads: set[threading.Thread] = set()
        self._changed = threading.Condition()

    @contextmanager
    def serving(self, context: WorkerContext, task: Task) -> Iterator[AttemptFunction]:
        """Give the opened task of a run, in its folder.

        The threads of a process share the folder and what is opened, so they serve one run at a
        time.
        """
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
                raise OutputError(
                    context.folder,
                    f"no such folder on {socket.gethostname()}",
                    "folders that all machines share",
                    "start the run in one of them",
                ) from error
            self.run = context.run
            self._attempts = opened(task)
        return self._attempts

    def end(self, run: str) -> None:
        """End a run in this process: let each thread finish its scan, and wait for them to end.

        What belongs to a thread, such as tensors, must not be freed while Python shuts down.
        """
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
"""State of this process."""


def attempt_chunk(context: WorkerContext, task: Task, scans: Chunk) -> list[Attempt]:
    """Attempt the scans of a chunk, in a worker."""
    MARK.set(context.mark)
    use_threads(context.threads)
    found: list[Attempt] = []
    with WORKER.serving(context, task) as attempts:
        for attempt in attempts(scans):
            found.append(attempt)
            if WORKER.ended == context.run or (context.stop and attempt[2]):
                break
    return found


def own_device(device: str, gpus: int) -> str:
    """Return the device for this process: in a worker, "auto" and "cuda" become a GPU of its own.

    Workers beyond the number of GPUs share them evenly. A device that was named stays.

    `device`: as `load_network` takes it; `gpus`: number of visible ones.
    """
    if not WORKER.run or device not in ("auto", "cuda") or gpus < 2:
        return device
    if WORKER.slot is None:
        try:
            WORKER.slot = take_slot(_folder_of_slots())
        except (OSError, NotImplementedError) as error:
            log.warning("GPUs are shared by chance, since workers cannot be counted: %s", error)
            WORKER.slot = (os.getpid(), None)
    return f"cuda:{WORKER.slot[0] % gpus}"


def take_slot(folder: Path) -> tuple[int, object]:
    """Return the lowest number that no other process holds, from 0, and the lock on it.

    The system releases the lock when the process ends, however that ends.
    """
    from filelock import FileLock, Timeout

    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    number = 0
    while True:
        lock = FileLock(folder / str(number))
        try:
            lock.acquire(timeout=0)
        except Timeout:
            number += 1
        else:
            return number, lock


def _folder_of_slots() -> Path:
    """Return a folder of this user's; processes that see other GPUs are counted apart."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    digest = hashlib.sha256(visible.encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"salsanext-gpus-{getpass.getuser()}-{digest}"
