# SPDX-License-Identifier: MIT
"""Workers of a Dask or Ray cluster, or of one that is started on this machine."""

import atexit
import logging
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager, redirect_stdout
from multiprocessing import TimeoutError
from multiprocessing.pool import AsyncResult, ThreadPool
from pathlib import Path
from typing import Any

from salsanext_cli.errors import MissingDependency, UsageError
from salsanext_cli.interruption import ARRIVED
from salsanext_cli.parallel import ray_guard
from salsanext_cli.parallel.options import RunOptions, cores
from salsanext_cli.parallel.worker import CHUNKS_IN_FLIGHT, WorkerPool, signals_blocked

CONNECT_TIMEOUT_S = 15
"""Time for a scheduler to answer, and for a first worker to come; Ray itself waits for minutes."""
END_TIMEOUT_S = 3.0
"""Time for the threads of Ray's pool to end, and then for Ray itself."""
START_POLL_S = 0.1


@contextmanager
def dask_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Connect to a scheduler, or start at most so many workers here that end with the run."""
    try:
        import distributed
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise _not_installed("dask") from error
    here = min(max_workers, options.workers_here()) if options.scheduler is None else None
    with (
        _local_cluster(distributed, here)
        if here
        else _connected_to_dask(distributed, options.scheduler) as client
    ):
        slots = sum(client.nthreads().values())
        workers = here or options.workers_of_cluster() or slots
        limited = not here and options.workers_of_cluster()
        yield WorkerPool(
            {"backend": _dask_backend(client)},
            workers,
            workers if limited else CHUNKS_IN_FLIGHT * workers,
            max(1, (cores() if here else slots) // workers),
            (KilledWorker, CancelledError),
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
def _local_cluster(distributed: Any, workers: int) -> Iterator[Any]:
    with signals_blocked(signal.SIGINT):
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        )
        client = distributed.Client(cluster, set_as_default=False)
    with cluster, client:
        yield client


@contextmanager
def _connected_to_dask(distributed: Any, address: str | None) -> Iterator[Any]:
    with ExitStack() as held:
        try:
            made = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
            client = held.enter_context(made)
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            expected = "a Dask scheduler with workers, such as tcp://host:8786"
            raise UsageError(f"--scheduler {address}", _first_line(error), expected) from error
        yield client


@contextmanager
def ray_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Connect to a cluster, or start at most so many workers here that end with the run."""
    try:
        import ray
    except ImportError as error:
        raise _not_installed("ray") from error
    started = options.scheduler is None and not ray.is_initialized()
    here = min(max_workers, options.workers_here()) if started else None
    # Ray tells on stdout that a worker died.
    with redirect_stdout(sys.stderr), _connected_to_ray(ray, options.scheduler, here):
        cpus, gpus = _resources(ray, "CPU"), _resources(ray, "GPU")
        slots = sum(cpus)
        if slots < 2:
            # Joblib does the work of a single worker itself, and Ray wants a CPU for each.
            raise UsageError("--backend ray", "a cluster of one CPU", "at least two")
        workers = min(here or options.workers_of_cluster() or slots, slots)
        yield WorkerPool(
            {"backend": _ray_backend(workers, sum(gpus)), "n_jobs": max(2, workers)},
            workers,
            1 if workers == 1 else CHUNKS_IN_FLIGHT * workers,
            max(1, cores() // workers if here else min(max(cpus), slots // workers)),
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
def _connected_to_ray(ray: Any, address: str | None, here: int | None) -> Iterator[None]:
    """Connect, or start workers here, unless the program that calls us has done so."""
    if ray.is_initialized():
        yield
        return
    # It would tell its makers that it was used.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    with ExitStack() as held:
        folder = held.enter_context(_guarded_folder()) if here else None
        # In the main thread Ray takes SIGTERM over, and a signal would leave it half started. Its
        # processes end with the thread that started them.
        with signals_blocked(signal.SIGINT):
            thread = held.enter_context(ThreadPool(1))
        started = thread.apply_async(_start_ray, (ray, address, here, folder, quiet))
        held.callback(_leave_ray, ray, thread, started)
        while not started.ready() and not ARRIVED:
            started.wait(START_POLL_S)
        if ARRIVED:
            raise KeyboardInterrupt
        started.get()
        held.callback(_join_result_threads)
        if threading.current_thread() is threading.main_thread():
            # Ray puts a handler that prints a traceback beneath Python's.
            signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))
        yield


def _leave_ray(ray: Any, thread: ThreadPool, started: AsyncResult[None]) -> None:
    """End Ray, or the connection, in order, unless its server is no more or is not there yet."""
    try:
        thread.apply_async(ray.shutdown).get(END_TIMEOUT_S if started.ready() else 0)
    except TimeoutError:
        # It would be tried again when Python ends.
        atexit.unregister(ray.shutdown)


@contextmanager
def _guarded_folder() -> Iterator[str]:
    """Make a folder for a Ray that is started here; none of its processes outlives this one."""
    # The paths of Ray's sockets, which have long names, must not exceed 103 characters.
    default = "/tmp" if os.name == "posix" else tempfile.gettempdir()
    base = Path(os.environ.get("RAY_TMPDIR", default))
    base.mkdir(parents=True, exist_ok=True)
    folder = os.path.realpath(tempfile.mkdtemp(prefix="ray-", dir=base))
    command = [sys.executable, "-I", "-S", ray_guard.__file__, str(os.getpid()), folder]
    none = subprocess.DEVNULL
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=none, stderr=none, start_new_session=True
    ):
        yield folder


def _join_result_threads() -> None:
    """Let the threads of Ray's pool end: one that still asks for a result would connect again."""
    from ray.util.multiprocessing.pool import ResultThread

    end = time.monotonic() + END_TIMEOUT_S
    for thread in threading.enumerate():
        if isinstance(thread, ResultThread):
            thread.join(max(0.0, end - time.monotonic()))


def _start_ray(
    ray: Any, address: str | None, here: int | None, folder: str | None, quiet: dict[str, Any]
) -> None:
    if here:
        local = {"address": "local", "include_dashboard": False, "_temp_dir": folder}
        ray.init(num_cpus=max(2, here), **local, **quiet)
        return
    address = address or ""
    try:
        if found := re.fullmatch(r"(?:ray://)?\[?([^/]+?)]?:(\d+)", address):
            peer = found[1], int(found[2])
            socket.create_connection(peer, CONNECT_TIMEOUT_S).close()
        ray.init(address=address, **quiet)
    except (OSError, ValueError, RuntimeError, OverflowError) as error:
        expected = "a Ray cluster, such as host:6379, ray://host:10001 or auto"
        raise UsageError(f"--scheduler {address}", _first_line(error), expected) from error


def _not_installed(backend: str) -> MissingDependency:
    remedy = f"pip install 'salsanext[{backend}]'"
    found = f"{backend.capitalize()} is not installed"
    return MissingDependency(f"--backend {backend}", found, remedy=remedy)


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
