# SPDX-License-Identifier: MIT
"""Workers of a Ray cluster, or of one that is started on this machine."""

from __future__ import annotations

import logging
import math
import os
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from salsanext_cli.errors import MissingDependency, UsageError
from salsanext_cli.parallel.backends import AHEAD, WorkerPool, block_interrupts
from salsanext_cli.parallel.tasks import WorkerContext
from salsanext_cli.parallel.threads import cores, threads_each

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import RunOptions

PATIENCE = 15
"""Seconds for a cluster to answer; Ray itself waits for minutes."""
TRIES = 3
"""How often a chunk is sent again whose worker died."""


class _RayPool:
    """Ray as a pool of processes, each of which works on one chunk at a time."""

    def __init__(self, ray: Any, cpus: int, gpus: float) -> None:
        self.ray = ray
        # Ray would end a process that uses a GPU after one call, and the network with it.
        self.remote = ray.remote(num_cpus=cpus, num_gpus=gpus, max_retries=TRIES, max_calls=0)(
            _called
        )

    def send(self, call: Callable[[], Any]) -> Any:
        return self.remote.remote(call).future()

    def result_of(self, future: Any) -> Any:
        from salsanext_cli.parallel.futures import Loss

        try:
            return future.result()
        except self.ray.exceptions.RayTaskError as error:
            raise error.cause from error
        except self.ray.exceptions.RayError as error:
            return Loss(str(error).partition(".")[0])

    def cancel(self, futures: list[Any]) -> None:
        for future in futures:
            self.ray.cancel(future.object_ref, force=True)


def _called(call: Callable[[], Any]) -> Any:
    return call()


@contextmanager
def ray_crew(options: RunOptions, most: int, context: WorkerContext) -> Iterator[WorkerPool]:
    """Connect to a cluster, or start workers here that end with the run."""
    ray = _ray()
    wanted = options.wanted()
    if options.scheduler is None and not ray.is_initialized():
        workers = min(most, options.workers_here())
        with _here(ray, workers):
            yield _crew(ray, context, workers, AHEAD * workers, 1, threads_each(cores(), workers))
        return
    with _there(ray, options.scheduler):
        slots = max(1, int(ray.cluster_resources().get("CPU", 1)))
        workers = wanted or slots
        largest = max(int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"])
        cpus = max(1, min(largest, threads_each(slots, workers)))
        yield _crew(ray, context, workers, wanted or AHEAD * slots, cpus, cpus)


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise MissingDependency(
            "--backend ray", "Ray is not installed", remedy="pip install 'salsanext[ray]'"
        ) from error
    return ray


def _crew(
    ray: Any, context: WorkerContext, workers: int, in_flight: int, cpus: int, threads: int
) -> WorkerPool:
    from salsanext_cli.parallel.futures import FuturesBackend

    gpus = ray.cluster_resources().get("GPU", 0)
    # Ray counts in parts of ten thousand, and shows a worker the GPU that it may use.
    share = min(1.0, math.floor(1e4 * gpus / workers) / 1e4)
    backend = FuturesBackend(_RayPool(ray, cpus, share), workers)
    told = replace(context, folder=Path.cwd(), threads=threads)
    return WorkerPool({"backend": backend, "n_jobs": workers}, workers, told, in_flight)


@contextmanager
def _here(ray: Any, workers: int) -> Iterator[None]:
    with block_interrupts():
        _init(ray, address="local", num_cpus=workers, include_dashboard=False)
    try:
        yield
    finally:
        ray.shutdown()


@contextmanager
def _there(ray: Any, address: str | None) -> Iterator[None]:
    """Connect, unless the program that calls us has done so."""
    if ray.is_initialized():
        yield
        return

    def refused(found: str) -> UsageError:
        expected = "a Ray cluster, such as host:6379, ray://host:10001 or auto"
        return UsageError(f"--scheduler {address}", found, expected)

    try:
        if found := re.fullmatch(r"(?:ray://)?\[?([^/]+?)]?:(\d+)", address or ""):
            socket.create_connection((found[1], int(found[2])), PATIENCE).close()
        _init(ray, address=address)
    except (OSError, ValueError, RuntimeError, OverflowError) as error:
        raise refused(str(error).partition("\n")[0]) from error
    try:
        yield
    finally:
        ray.shutdown()


def _init(ray: Any, **options: Any) -> None:
    # It would tell its makers that it was used.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
