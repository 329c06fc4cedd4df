# SPDX-License-Identifier: MIT
"""Workers of a run: processes of this machine (joblib's loky) that open a task once.

`attempts_of_workers` sends the scans in chunks to workers, and yields their attempts to
`run_over_scans`, which counts them and handles failures. A worker overlaps the steps of the scans
of a chunk by `pipeline`.
If a worker dies, the attempts that were finished come first (`finished_attempts`), and
`WorkersLost` ends the run; nothing is attempted again.
"""

import os
import signal
import threading
import time
import warnings
from collections.abc import Generator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import groupby, pairwise
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any
from uuid import uuid4

from salsanext_cli.core import wording
from salsanext_cli.core.errors import WorkersLost
from salsanext_cli.io.files.atomic import MARK
from salsanext_cli.runs.loop.blocked_signals import signals_blocked
from salsanext_cli.runs.loop.finished_attempts import (
    FinishedAttempts,
    append_attempt,
    finished_attempts,
)
from salsanext_cli.runs.loop.job import Attempt, OpenableTask, Task
from salsanext_cli.runs.loop.pipeline import AttemptFunction, opened
from salsanext_cli.runs.loop.run_options import CHUNKS_IN_FLIGHT, RunOptions, cores
from salsanext_cli.runs.scans.scan_file import ScanFile

HARMLESS_WARNINGS = (
    # The user has stopped the run, perhaps after its last task.
    ".*tasks which were still being processed",
    ".*tasks have been successfully executed",
    # Loky itself replaces an idle worker that has grown while it loaded a network; nothing is lost.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib without use for a user; raised as errors, they would stop its threads."""
MANAGER_THREAD = "ExecutorManagerThread"  # Name of loky's thread that sends work to workers
MAX_CHUNK_SCANS = 16
"""Bound of the work that is lost with a worker, and of the scans between signs of progress."""
MIN_CHUNKS_PER_WORKER = 4  # Lower bound, so that the last chunks end at about the same time

WARNING_FILTERS = "PYTHONWARNINGS"  # Variable that a new interpreter reads
POLL_INTERVAL_S = 1.0  # Of a worker, whether its parent lives

Chunk = tuple[ScanFile, ...]  # Scans that a worker is sent together
_OPENED: dict[str, AttemptFunction] = {}  # Task of this process, by the run that it serves


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerProcess:
    """What a worker process has from the process that started it."""

    run_id: str  # Identifies the run, because a process serves several
    mark: str  # Begin of the names of temporary files
    folder: Path  # That names of files are relative to
    spelling: wording.Spelling  # Of arguments in messages


@dataclass(frozen=True, slots=True, kw_only=True)
class AttemptedChunk:
    """Attempts of a chunk, and its number."""

    number: int
    attempts: list[Attempt[Any]]


def attempts_of_workers(
    task: Task, scans: Sequence[ScanFile], options: RunOptions
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts of workers, which are killed when this is closed, in any order.

    If a worker dies, the attempts that it and the others have finished come before the error.
    """
    start_silent_trackers()
    with finished_attempts() as finished:
        try:
            yield from _attempts_by_chunk(task, scans, options, finished)
        except WorkersLost:
            yield from finished
            raise


def _attempts_by_chunk(
    task: Task, scans: Sequence[ScanFile], options: RunOptions, finished: FinishedAttempts
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts of workers, chunk by chunk."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    workers = min(len(scans), options.workers())
    most = task.max_chunk_scans if isinstance(task, OpenableTask) else MAX_CHUNK_SCANS
    stop = options.on_error == "stop"
    process = WorkerProcess(
        run_id=uuid4().hex, mark=MARK.get(), folder=Path.cwd(), spelling=wording.used()
    )
    function = partial(attempt_chunk, task, process, stop=stop)
    backend = joblib.parallel_config(
        "loky",
        n_jobs=workers,
        inner_max_num_threads=max(1, cores() // workers),
        initializer=end_with_parent,
        initargs=(os.getpid(),),
    )
    with warnings.catch_warnings():
        for message in HARMLESS_WARNINGS:
            warnings.filterwarnings("ignore", message)
        with backend:
            parallel = joblib.Parallel(
                return_as="generator_unordered",
                batch_size=1,
                pre_dispatch=CHUNKS_IN_FLIGHT * workers,
            )
        calls = (
            joblib.delayed(function)(scans_of_chunk, number, finished.file(number))
            for number, scans_of_chunk in enumerate(chunks(scans, workers, most))
        )
        try:
            with lost_chunks_hidden(), ExitStack() as stack:
                # A signal that has waited takes effect at the end of the inner body.
                with signals_blocked(signal.SIGINT, signal.SIGTERM):
                    results = stack.enter_context(closing(parallel(calls)))
                for chunk in results:
                    finished.forget(chunk.number)
                    yield from chunk.attempts
        except TerminatedWorkerError as error:
            problem = "the system ended a worker"
            hint = "use fewer jobs, which need less memory"
            subject = f"{wording.argument('jobs')} {workers}"
            raise WorkersLost(subject, problem, hint=hint) from error


def chunks(scans: Sequence[ScanFile], workers: int, most: int = MAX_CHUNK_SCANS) -> list[Chunk]:
    """Cut scans, in order, into chunks of one sequence and at most `most`, of similar sizes."""
    size = max(1, min(most, len(scans) // (MIN_CHUNKS_PER_WORKER * workers)))
    cut: list[Chunk] = []
    for _, group in groupby(scans, key=lambda scan: scan.sequence):
        sequence = tuple(group)
        count = -(-len(sequence) // size)
        borders = [len(sequence) * number // count for number in range(count + 1)]
        cut += [sequence[start:stop] for start, stop in pairwise(borders)]
    return cut


def end_with_parent(parent: int) -> None:
    """End this process within seconds of its parent, a process id, which may be killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_INTERVAL_S)
        os._exit(1)  # noqa: TID251

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


def attempt_chunk(
    task: Task,
    process: WorkerProcess,
    scans: Chunk,
    number: int,
    finished: Path | None,
    *,
    stop: bool,
) -> AttemptedChunk:
    """Attempt the scans of a chunk, in a worker process; `stop`: until one fails.

    `finished`: file to which each attempt is appended.
    """
    attempts = opened_once(task, process)
    done: list[Attempt[Any]] = []
    for attempt in attempts(scans, lambda _: None):
        append_attempt(finished, attempt)
        done.append(attempt)
        if stop and attempt.error:
            break
    return AttemptedChunk(number=number, attempts=done)


def opened_once(task: Task, process: WorkerProcess) -> AttemptFunction:
    """Return the opened task of a run in this worker process, which opens it at the first call."""
    MARK.set(process.mark)
    wording.use(process.spelling)
    if process.run_id not in _OPENED:
        _OPENED.clear()
        _enter(process.folder)
        _OPENED[process.run_id] = opened(task)
    return _OPENED[process.run_id]


def _enter(folder: Path) -> None:
    """Make a folder the current one, or the root where it is missing, as on a node of a cluster.

    Names that are relative to the folder then lead to no other file.
    """
    try:
        os.chdir(folder)
    except OSError:
        os.chdir(os.path.abspath(os.sep))  # noqa: PTH100 - the root


@contextmanager
def lost_chunks_hidden() -> Generator[None, None, None]:
    """Print no error of loky's thread about chunks that the end of the body has removed.

    The thread fails with `KeyError` if it has not sent them to a worker before. The workers are
    killed by then.
    """
    show = threading.excepthook

    def show_others(failed: threading.ExceptHookArgs) -> None:
        name = failed.thread.name if failed.thread else ""
        if not (name == MANAGER_THREAD and failed.exc_type is KeyError):
            show(failed)

    threading.excepthook = show_others
    try:
        yield
    finally:
        threading.excepthook = show


def start_silent_trackers() -> None:
    """Start the processes that remove semaphores and folders of this process after its end.

    A signal may end this process at once. The trackers then remove what it leaves, and print
    nothing: the warnings would follow the last line of the command.
    """
    from joblib.externals.loky.backend import resource_tracker as tracker_of_loky

    before = os.environ.get(WARNING_FILTERS)
    os.environ[WARNING_FILTERS] = "ignore"
    try:
        tracker_of_loky.ensure_running()
        if os.name == "posix":
            resource_tracker.ensure_running()
    finally:
        del os.environ[WARNING_FILTERS]
        if before is not None:
            os.environ[WARNING_FILTERS] = before
