# SPDX-License-Identifier: MIT
"""Workers of a run: threads and processes of this machine, what each does, and a GPU for each."""

import getpass
import hashlib
import logging
import os
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from salsanext_cli.errors import OutputError, SalsanextError
from salsanext_cli.files.atomic import MARK
from salsanext_cli.parallel.options import RunOptions, cores, threads_of_workers, use_threads
from salsanext_cli.results.layout import ScanFile

CHUNKS_IN_FLIGHT = 2  # Chunks sent per worker, so that the next is there when one is done
POLL_INTERVAL_S = 1.0
THREAD_TIMEOUT_S = 10.0

Chunk = tuple[ScanFile, ...]  # Scans that a worker is sent together
Attempt = tuple[ScanFile, Any, SalsanextError | None]  # A scan, its result, its error
AttemptFunction = Callable[[Iterable[ScanFile]], Iterator[Attempt]]
"""Works on scans in turn; a scan that fails is an attempt with an error."""

log = logging.getLogger(__name__)


@runtime_checkable
class OpenableTask(Protocol):
    """Task that is opened once per worker, since that is slow: it loads a network, say."""

    @property
    def max_chunk_scans(self) -> int:
        """Largest number of scans that a worker is sent together."""

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


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers that are ready."""

    backend: dict[str, Any]  # Arguments of `joblib.parallel_config`
    workers: int  # Number of chunks that are worked on side by side
    in_flight: int  # Number of chunks that are sent before the first comes back
    threads: int  # Threads that each worker may use
    died: tuple[type[BaseException], ...]  # Raised by the backend when a worker died


@contextmanager
def local_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Give a pool of threads or processes, at most so many; joblib starts them when needed."""
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    workers = min(max_workers, options.workers_here())
    threads = max(1, cores() // workers)
    backend: dict[str, Any] = {"backend": options.backend, "n_jobs": workers}
    died = (TerminatedWorkerError,)
    pool = WorkerPool(backend, workers, CHUNKS_IN_FLIGHT * workers, threads, died)
    if options.backend == "threading":
        with threads_of_workers(threads):
            yield pool
    else:
        backend |= {"initializer": end_with_parent, "initargs": (os.getpid(),)}
        backend["inner_max_num_threads"] = threads
        yield pool


@contextmanager
def signals_blocked(*signals: signal.Signals) -> Generator[None, None, None]:
    """Start threads and processes that signals do not reach, since this thread ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from joblib.externals.loky.backend import resource_tracker as tracker_of_loky

    # Starting these lets the signals through again, so they are started before.
    tracker_of_loky.ensure_running()
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
                expected, remedy = "folders that all machines share", "start the run in one of them"
                raise OutputError(context.folder, found, expected, remedy) from error
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


def attempt_chunk(context: WorkerContext, task: Task, scans: Chunk) -> list[Attempt]:
    """Attempt the scans of a chunk, in a worker."""
    MARK.set(context.mark)
    use_threads(context.threads)
    done: list[Attempt] = []
    with WORKER.serving(context, task) as attempts:
        for attempt in attempts(scans):
            done.append(attempt)
            if WORKER.ended == context.run or (context.stop and attempt[2]):
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
