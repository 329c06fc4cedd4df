# SPDX-License-Identifier: MIT
"""Workers of a run: threads and processes of this machine (joblib), or a Dask or Ray cluster."""

import logging
import os
import re
import signal
import socket
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import (
    AbstractContextManager,
    ExitStack,
    closing,
    contextmanager,
    nullcontext,
    redirect_stdout,
)
from dataclasses import dataclass
from functools import partial
from itertools import groupby, pairwise
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any
from uuid import uuid4

from salsanext_cli.errors import UsageError, WorkersLost
from salsanext_cli.files.atomic import MARK
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.parallel.job import Attempt, OpenableTask, Task
from salsanext_cli.parallel.options import CLUSTERS, RunOptions, cores, threads_of_workers
from salsanext_cli.parallel.worker import (
    WORKER,
    Chunk,
    WorkerContext,
    attempt_chunk,
    end_with_parent,
)
from salsanext_cli.results.layout import ScanFile

CHUNKS_IN_FLIGHT = 2  # Chunks sent per worker, so that the next is there when one is done
CONNECT_TIMEOUT_S = 15  # For a scheduler and a first worker; Ray itself waits for minutes
RESULT_TIMEOUT_S = 3.0
HARMLESS_WARNINGS = (
    # Who stops a run knows that it has been stopped.
    ".*tasks which were still being processed",
    # A worker that grows, as it does when it loads a network, is replaced by a fresh one.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib that say nothing to a user; raised as errors, they would stop its threads."""

MAX_CHUNK_SCANS = 16
"""Bound of the work that is lost with a worker, and of the scans between signs of progress."""
MIN_CHUNKS_PER_WORKER = 4  # Lower bound, so that the last chunks end about together


@dataclass(frozen=True, slots=True)
class WorkerPool:
    """Workers that are ready."""

    backend: dict[str, Any]  # Arguments of `joblib.parallel_config`
    workers: int  # Number of chunks that are worked on side by side
    in_flight: int  # Number of chunks that are sent before the first comes back
    threads: int  # Threads that each worker may use
    died: tuple[type[BaseException], ...]  # Raised by the backend when a worker died


def attempts_of_workers(
    task: Task, scans: Sequence[ScanFile], options: RunOptions
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts that workers make, in no particular order."""
    stop = options.on_error == "stop"
    with warnings.catch_warnings():
        for message in HARMLESS_WARNINGS:
            warnings.filterwarnings("ignore", message)
        with _pool(options, len(scans)) as pool:
            context = WorkerContext(uuid4().hex, MARK.get(), stop, Path.cwd(), pool.threads)
            work = partial(attempt_chunk, context, task)
            most = task.max_chunk_scans if isinstance(task, OpenableTask) else MAX_CHUNK_SCANS
            try:
                cut = chunks(scans, pool.workers, most)
                yield from _of_chunks(work, cut, pool, options.backend)
            finally:
                # Joblib kills processes, but cannot kill threads and does not wait for them.
                WORKER.end(context.run)


def _pool(options: RunOptions, scans: int) -> AbstractContextManager[WorkerPool]:
    """Start workers for so many scans, or connect to those of a cluster; end that afterwards."""
    if options.backend not in CLUSTERS:
        return local_pool(options, scans)
    return {"dask": dask_pool, "ray": ray_pool}[options.backend](options)


def chunks(scans: Sequence[ScanFile], workers: int, most: int = MAX_CHUNK_SCANS) -> list[Chunk]:
    """Cut scans, in order, into chunks of one sequence and at most `most`, of similar sizes."""
    size = max(1, min(most, len(scans) // (MIN_CHUNKS_PER_WORKER * workers)))
    cut: list[Chunk] = []
    for _, group in groupby(scans, key=lambda scan: scan.sequence):
        run = tuple(group)
        parts = -(-len(run) // size)
        borders = [len(run) * part // parts for part in range(parts + 1)]
        cut += [run[start:stop] for start, stop in pairwise(borders)]
    return cut


def _of_chunks(
    work: Callable[[Chunk], list[Attempt[Any]]],
    cut: Iterable[Chunk],
    pool: WorkerPool,
    backend: str,
) -> Generator[Attempt[Any], None, None]:
    import joblib

    with joblib.parallel_config(**pool.backend):
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, pre_dispatch=pool.in_flight
        )
    try:
        with signals_blocked(signal.SIGINT, signal.SIGTERM) if backend == "loky" else nullcontext():
            attempts = parallel(joblib.delayed(work)(chunk) for chunk in cut)
        with closing(attempts):
            for of_chunk in attempts:
                yield from of_chunk
    except pool.died as error:
        subject, found = f"--backend {backend} --jobs {pool.workers}", "the system ended a worker"
        raise WorkersLost(subject, found, "memory for all of them", "use fewer jobs") from error


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


@contextmanager
def dask_pool(options: RunOptions) -> Iterator[WorkerPool]:
    """Connect to the workers of a scheduler."""
    distributed = import_extra("distributed", "dask")
    with ExitStack() as held:
        try:
            made = distributed.Client(
                options.scheduler, timeout=CONNECT_TIMEOUT_S, set_as_default=False
            )
            client = held.enter_context(made)
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            expected = "a Dask scheduler with workers, such as tcp://host:8786"
            subject = f"--scheduler {options.scheduler}"
            raise UsageError(subject, _first_line(error), expected) from error
        slots = sum(client.nthreads().values())
        limit = options.workers_of_cluster()
        workers = limit or slots
        yield WorkerPool(
            {"backend": _dask_backend(client)},
            workers,
            limit or CHUNKS_IN_FLIGHT * workers,
            max(1, slots // workers),
            (distributed.scheduler.KilledWorker, CancelledError),
        )


def _dask_backend(client: Any) -> Any:
    from joblib._dask import DaskDistributedBackend

    class DaskBackend(DaskDistributedBackend):  # type: ignore[misc]
        """Backend of joblib that would wait for ever for a chunk whose workers died."""

        def effective_n_jobs(self, n_jobs: int) -> Any:
            # Joblib does the work of a single worker itself.
            return max(2, super().effective_n_jobs(n_jobs))

        def submit(self, func: Any, callback: Callable[[Any], object]) -> Any:
            def pass_on_error(done: Future[Any]) -> None:
                if error := done.exception():
                    callback(error)

            future = super().submit(func, callback)
            future.add_done_callback(pass_on_error)
            return future

    return DaskBackend(client=client)


@contextmanager
def ray_pool(options: RunOptions) -> Iterator[WorkerPool]:
    """Connect to the workers of a cluster, unless the program that calls us has done so."""
    ray = import_extra("ray", "ray")
    # Ray tells on stdout that a worker died.
    with redirect_stdout(sys.stderr), _connected_to_ray(ray, options.scheduler):
        cpus, gpus = _resources(ray, "CPU"), _resources(ray, "GPU")
        slots = sum(cpus)
        if slots < 2:
            # Joblib does the work of a single worker itself, and Ray wants a CPU for each.
            raise UsageError("--backend ray", "a cluster of one CPU", "at least two")
        workers = min(options.workers_of_cluster() or slots, slots)
        yield WorkerPool(
            {"backend": _ray_backend(workers, sum(gpus)), "n_jobs": max(2, workers)},
            workers,
            1 if workers == 1 else CHUNKS_IN_FLIGHT * workers,
            max(1, min(max(cpus), slots // workers)),
            (ray.exceptions.RayActorError, ray.exceptions.OutOfMemoryError),
        )


def _resources(ray: Any, kind: str) -> list[int]:
    """Return how many CPUs or GPUs each machine has."""
    return [int(node["Resources"].get(kind, 0)) for node in ray.nodes() if node["Alive"]]


def _ray_backend(workers: int, gpus: int) -> Any:
    """Return joblib's backend; it waits until all workers have what they reserve."""
    from ray.util.joblib.ray_backend import RayBackend

    class UnorderedRayBackend(RayBackend):
        """Backend that does not say that it can give results as they come."""

        supports_return_generator = True

    reserved = (
        {"num_cpus": 0, "num_gpus": 1 / -(-max(2, workers) // gpus)} if gpus else {"num_cpus": 1}
    )
    return UnorderedRayBackend(ray_remote_args={**reserved, "scheduling_strategy": "SPREAD"})


@contextmanager
def _connected_to_ray(ray: Any, address: str | None) -> Iterator[None]:
    if ray.is_initialized():
        yield
        return
    # It would tell its makers that it was used.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    on_sigterm = signal.getsignal(signal.SIGTERM)
    try:
        _connect_to_ray(ray, address)
        if threading.current_thread() is threading.main_thread():
            # Ray takes it over, and puts a handler that prints a traceback beneath Python's.
            signal.signal(signal.SIGTERM, on_sigterm)
        yield
    finally:
        _join_result_threads()
        ray.shutdown()


def _connect_to_ray(ray: Any, address: str | None) -> None:
    try:
        if host_port := re.fullmatch(r"(?:ray://)?\[?([^/]+?)]?:(\d+)", address or ""):
            peer = host_port[1], int(host_port[2])
            socket.create_connection(peer, CONNECT_TIMEOUT_S).close()
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, ValueError, RuntimeError, OverflowError) as error:
        expected = "a Ray cluster, such as host:6379, ray://host:10001 or auto"
        raise UsageError(f"--scheduler {address}", _first_line(error), expected) from error


def _join_result_threads() -> None:
    """Let the threads of Ray's pool end: one that still asks for a result would connect again."""
    from ray.util.multiprocessing.pool import ResultThread

    end = time.monotonic() + RESULT_TIMEOUT_S
    for thread in threading.enumerate():
        if isinstance(thread, ResultThread):
            thread.join(max(0.0, end - time.monotonic()))


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
