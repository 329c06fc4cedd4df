# SPDX-License-Identifier: MIT
"""Workers of a running Dask or Ray cluster."""

import logging
import os
import re
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager, redirect_stdout
from typing import Any

from salsanext_cli.errors import UsageError
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.parallel.options import RunOptions
from salsanext_cli.parallel.worker import CHUNKS_IN_FLIGHT, WorkerPool

CONNECT_TIMEOUT_S = 15  # For a scheduler and a first worker; Ray itself waits for minutes
RESULT_TIMEOUT_S = 3.0


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
