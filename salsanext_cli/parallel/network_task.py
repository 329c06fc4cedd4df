# SPDX-License-Identifier: MIT
"""Task that needs a network, which each worker loads once: scan by scan or in batches."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import isgeneratorfunction
from itertools import islice
from typing import Any

from salsanext_cli.engines.device import MAX_BATCH_PIXELS, choose_device
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import FormatError, SalsanextError, out_of_memory
from salsanext_cli.parallel.worker import Attempt, AttemptFunction, one_by_one, own_device
from salsanext_cli.results.layout import ScanFile

MAX_BATCH_SCANS = 16
"""Scans computed together on a GPU; as many as a worker is sent together."""

Steps = Iterator[Any]
"""Work on a scan: yields when the scan is read, when its results are computed, and the result."""


@dataclass(frozen=True, slots=True)
class NetworkTask:
    """Function of a scan and a network."""

    # Takes a scan file and a network; picklable. It returns the result or yields `Steps`, which
    # overlap on a CPU
    function: Callable[[ScanFile, Network], Any]
    settings: NetworkSettings  # Resolved: what the workers load
    # The same, loaded in this process; it is not sent to others
    network: Network | None = field(default=None, compare=False)
    # Does the same to several scans together, and yields an attempt of each
    batch_function: Callable[[Sequence[ScanFile], Network], Iterator[Attempt]] | None = None
    # Scans computed together; by default one on a CPU, as many as keep it busy on a GPU
    batch: int | None = None

    def open(self) -> AttemptFunction:
        """Load the network, unless it is there, and decide between one by one and batches."""
        network = self.network or _loaded(self.settings)
        on_cpu, several = network.device == "cpu", self.batch_function
        pixels = network.sensor.height * network.sensor.width
        usual = 1 if on_cpu else max(1, min(MAX_BATCH_SCANS, MAX_BATCH_PIXELS // pixels))
        size, in_steps = self.batch or usual, isgeneratorfunction(self.function)

        def steps(file: ScanFile) -> Steps:
            with named_if_too_large(file, network):
                if in_steps:
                    yield from self.function(file, network)
                else:
                    yield self.function(file, network)

        def in_batches(files: Iterable[ScanFile]) -> Iterator[Attempt]:
            waiting = iter(files)
            while several and (batch := tuple(islice(waiting, size))):
                yield from several(batch, network)

        if several and not (on_cpu and size == 1):
            return in_batches
        if in_steps and on_cpu:
            return partial(overlapping, steps)
        return partial(one_by_one, lambda file: [*steps(file)][-1])

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self.function, self.settings, None, self.batch_function, self.batch)
        return NetworkTask, parts


def _loaded(settings: NetworkSettings) -> Network:
    """Load the network of this process, on a GPU of its own if it is a worker."""
    device = choose_device(settings.device)
    if device != "cpu":
        import torch

        device = own_device(settings.device, torch.cuda.device_count())
    return replace(settings, device=device).load()


@contextmanager
def named_if_too_large(file: ScanFile, network: Network) -> Iterator[None]:
    """Turn memory that runs out into an error of one scan."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not out_of_memory(error):
            raise
        found = f"is too large for the memory of {network.device}"
        raise FormatError(file.path, found, remedy="use --device cpu") from error


def overlapping(begin: Callable[[ScanFile], Steps], files: Iterable[ScanFile]) -> Iterator[Attempt]:
    """Attempt scans in order; while one is computed, a thread writes the last and reads the next.

    `begin`: returns the steps of a scan, of which the second is done in this thread.
    """
    pool = ThreadPoolExecutor(1, "salsanext-files")
    waiting = iter(files)

    def step(file: ScanFile, steps: Steps) -> Attempt:
        try:
            return file, next(steps), None
        except SalsanextError as error:
            return file, None, error

    def beside(file: ScanFile, steps: Steps) -> Future[Attempt]:
        return pool.submit(copy_context().run, step, file, steps)

    def read_next() -> tuple[Steps, Future[Attempt]] | None:
        if (file := next(waiting, None)) is None:
            return None
        steps = begin(file)
        return steps, beside(file, steps)

    try:
        ahead, last = read_next(), None
        while ahead:
            steps, reading = ahead
            try:
                file, _, error = reading.result()
                ahead = read_next()
                if error is None:
                    file, _, error = step(file, steps)
            except Exception:
                # A bug at this scan comes after what has become of the one before.
                if last:
                    yield last.result()
                raise
            except BaseException:
                # No error may hide an interrupt, but the scan before may have its results.
                if last and last.exception() is None and last.result()[2] is None:
                    yield last.result()
                raise
            if last:
                yield last.result()
            if error is None:
                last = beside(file, steps)
            else:
                last = Future()
                last.set_result((file, None, error))
        if last:
            yield last.result()
    finally:
        pool.shutdown(cancel_futures=True)
