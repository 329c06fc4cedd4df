# SPDX-License-Identifier: MIT
"""Workers of a Dask cluster, or of one that is started on this machine."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from typing import Any

from salsanext_cli.errors import MissingDependency, UsageError
from salsanext_cli.parallel.options import RunOptions
from salsanext_cli.parallel.pools import CHUNKS_IN_FLIGHT, WorkerPool
from salsanext_cli.parallel.processes import signals_blocked
from salsanext_cli.parallel.threads import cores, threads_each

CONNECT_TIMEOUT_S = 15
"""Time for a scheduler to answer, and then for the first worker to come."""


@contextmanager
def dask_pool(options: RunOptions, max_workers: int) -> Iterator[WorkerPool]:
    """Connect to a scheduler, or start at most so many workers here that end with the run."""
    try:
        import distributed
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise MissingDependency(
            "--backend dask", "Dask is not installed", remedy="pip install 'salsanext[dask]'"
        ) from error
    here = min(max_workers, options.workers_here()) if options.scheduler is None else None
    with (
        _local_cluster(distributed, here)
        if here
        else _connected(distributed, options.scheduler) as client
    ):
        slots = sum(client.nthreads().values())
        workers = here or options.workers_of_cluster() or slots
        limited = not here and options.workers_of_cluster()
        yield WorkerPool(
            {"backend": _backend(client)},
            workers,
            workers if limited else CHUNKS_IN_FLIGHT * workers,
            threads_each(cores() if here else slots, workers),
            (KilledWorker, CancelledError),
        )


def _backend(client: Any) -> Any:
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
def _connected(distributed: Any, address: str | None) -> Iterator[Any]:
    def refused(error: Exception) -> UsageError:
        found = str(error).partition("\n")[0]
        expected = "a Dask scheduler with workers, such as tcp://host:8786"
        return UsageError(f"--scheduler {address}", found, expected)

    try:
        client = distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise refused(error) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            raise refused(error) from error
        yield client
