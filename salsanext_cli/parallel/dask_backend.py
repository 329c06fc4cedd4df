# SPDX-License-Identifier: MIT
"""Workers of a Dask cluster, or of one that is started on this machine."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from salsanext_cli.errors import MissingDependency, UsageError
from salsanext_cli.parallel.backends import AHEAD, WorkerPool, block_interrupts
from salsanext_cli.parallel.tasks import WorkerContext
from salsanext_cli.parallel.threads import cores, threads_each

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import RunOptions

PATIENCE = 15
"""Seconds for a scheduler to answer, and then for the first worker to come."""


class _DaskPool:
    """Dask as a pool; it sends what a dead worker was at to another one, some times."""

    def __init__(self, client: Any) -> None:
        from distributed.scheduler import KilledWorker

        self.client = client
        self.lost = (KilledWorker, concurrent.futures.CancelledError, asyncio.CancelledError)

    def send(self, call: Callable[[], Any]) -> Any:
        return self.client.submit(call, pure=False, key=f"salsanext-{uuid4().hex}")

    def result_of(self, future: Any) -> Any:
        from salsanext_cli.parallel.futures import Loss

        try:
            return future.result()
        except self.lost as error:
            return Loss(str(error).partition(". ")[0])

    def cancel(self, futures: list[Any]) -> None:
        self.client.cancel(futures)


@contextmanager
def dask_crew(options: RunOptions, most: int, context: WorkerContext) -> Iterator[WorkerPool]:
    """Connect to a scheduler, or start workers here that end with the run."""
    distributed = _distributed()
    if options.scheduler is None:
        workers = min(most, options.workers_here())
        with _here(distributed, workers) as client:
            yield _crew(client, context, workers, AHEAD * workers, cores())
        return
    with _there(distributed, options.scheduler) as client:
        slots = sum(client.nthreads().values())
        wanted = options.wanted()
        yield _crew(client, context, wanted or slots, wanted or AHEAD * slots, slots)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise MissingDependency(
            "--backend dask", "Dask is not installed", remedy="pip install 'salsanext[dask]'"
        ) from error
    return distributed


def _crew(
    client: Any, context: WorkerContext, workers: int, in_flight: int, slots: int
) -> WorkerPool:
    from salsanext_cli.parallel.futures import FuturesBackend

    parallel = {"backend": FuturesBackend(_DaskPool(client), workers), "n_jobs": workers}
    told = replace(context, folder=Path.cwd(), threads=threads_each(slots, workers))
    return WorkerPool(parallel, workers, told, in_flight)


@contextmanager
def _here(distributed: Any, workers: int) -> Iterator[Any]:
    with block_interrupts():
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
def _there(distributed: Any, address: str) -> Iterator[Any]:
    def refused(found: str) -> UsageError:
        expected = "a Dask scheduler with workers, such as tcp://host:8786"
        return UsageError(f"--scheduler {address}", found, expected)

    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise refused(str(error).partition("\n")[0]) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise refused("no workers") from error
        yield client
