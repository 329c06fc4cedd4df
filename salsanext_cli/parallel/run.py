# SPDX-License-Identifier: MIT
"""Run of one task over many scans: some done already, some in parallel, some failing.

A task that needs a network loads it once per worker, and goes scan by scan or in batches.
"""

import logging
import signal
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import isgeneratorfunction
from itertools import groupby, islice, pairwise
from pathlib import Path
from typing import Any, ClassVar
from uuid import uuid4

from salsanext_cli.engines.device import MAX_BATCH_PIXELS, choose_device
from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import FormatError, SalsanextError, WorkersLost, first_few, out_of_memory
from salsanext_cli.files.atomic import MARK
from salsanext_cli.measures.scan_summary import RunSummary
from salsanext_cli.parallel.options import CLUSTERS, Progress, RunOptions
from salsanext_cli.parallel.worker import (
    WORKER,
    Attempt,
    AttemptFunction,
    Chunk,
    OpenableTask,
    Task,
    WorkerContext,
    WorkerPool,
    attempt_chunk,
    local_pool,
    one_by_one,
    opened,
    own_device,
    signals_blocked,
)
from salsanext_cli.records import Float
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.selection import MissingResults

__all__ = [
    "Failure",
    "NetworkTask",
    "Outcome",
    "Progress",
    "RunOptions",
    "ScanSteps",
    "run_over_scans",
]

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
MAX_BATCH_SCANS = 16  # Scans computed together on a GPU, as many as a worker is sent

ScanSteps = Generator[Any, Any, Any]
"""Work on a scan: yields when the scan is read, when its results are computed, and the result."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Failure:
    """Scan that could not be worked on, the reason, and the code of the error."""

    scan: ScanFile
    reason: str
    code: str

    def to_dict(self) -> dict[str, str]:
        """Return plain data for JSON."""
        return {"scan": str(self.scan.path), "reason": self.reason, "code": self.code}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Numbers of a run."""

    skipped: int  # Scans that were done already
    failures: tuple[Failure, ...]  # Scans that failed, in order
    done: int  # Scans that were worked on with success
    # Scans left out for want of results to work on, by a stage that looks for them
    missing: MissingResults | None = None
    seconds: float = 0.0  # Time of the work on scans, without the start of the command
    summary: RunSummary | None = None  # Of the scans that were worked on
    # Number of their points that were written as unlabelled for their error, if that was asked
    rejected_points: int | None = None
    # Number of their points, and of those among them that a stage kept that leaves some out
    kept_points: tuple[int, int] | None = None


def run_over_scans(
    task: Task,
    scans: Sequence[ScanFile],
    options: RunOptions,
    *,
    is_done: Callable[[ScanFile], bool] = lambda scan: False,
    on_result: Callable[[Any], object] = lambda result: None,
    summary: RunSummary | None = None,
) -> Outcome:
    """Run a task over this shard's scans that are not done; results go to `on_result`, here.

    `summary`: takes the results, which are numbers about each scan, in its place.
    """
    on_result = summary.add if summary else on_result
    start = time.monotonic()
    mine = options.shard.of(scans)
    todo = [scan for scan in mine if options.overwrite or not is_done(scan)]
    failures: list[Failure] = []
    tried: set[ScanFile] = set()
    try:
        with closing(_attempts(task, todo, options)) as attempts:
            for scan, result, error in attempts:
                log.info("%s: %s", scan.name, error or "done")
                if error is None:
                    on_result(result)
                elif options.on_error == "stop":
                    raise error
                else:
                    failures.append(Failure(scan, str(error), error.code))
                tried.add(scan)
                if options.progress:
                    options.progress(len(tried), len(todo))
        if len(tried) < len(todo):
            found, remedy = "not every scan was worked on", "use fewer jobs"
            raise WorkersLost(f"--backend {options.backend}", found, remedy=remedy)
    except WorkersLost as lost:
        for failure in failures:
            log.error("%s", failure.reason)
        left = [scan for scan in todo if scan not in tried and not is_done(scan)]
        names = first_few([scan.name for scan in left])
        found = f"{lost.found}; {len(left)} of {len(todo)} scans are missing: {names}"
        remedy = f"{lost.remedy}; run again for the rest"
        raise WorkersLost(lost.subject, found, lost.expected, remedy) from lost
    failures.sort(key=lambda failure: failure.scan)
    skipped, done = len(mine) - len(todo), len(todo) - len(failures)
    seconds = time.monotonic() - start
    return Outcome(skipped, tuple(failures), done, seconds=seconds, summary=summary)


def _pool(options: RunOptions, scans: int) -> AbstractContextManager[WorkerPool]:
    """Start workers for so many scans, or connect to those of a cluster; end that afterwards."""
    if options.backend not in CLUSTERS:
        return local_pool(options, scans)
    from salsanext_cli.parallel import clusters

    return {"dask": clusters.dask_pool, "ray": clusters.ray_pool}[options.backend](options)


def _attempts(
    task: Task, scans: list[ScanFile], options: RunOptions
) -> Generator[Attempt, None, None]:
    """Yield the attempts of all scans, in no particular order where workers make them."""
    if not scans:
        return
    if options.backend not in CLUSTERS and min(len(scans), options.workers_here()) == 1:
        yield from opened(task)(scans)
        return
    stop = options.on_error == "stop"
    with warnings.catch_warnings():
        for message in HARMLESS_WARNINGS:
            warnings.filterwarnings("ignore", message)
        with _pool(options, len(scans)) as pool:
            context = WorkerContext(uuid4().hex, MARK.get(), stop, Path.cwd(), pool.threads)
            attempt = partial(attempt_chunk, context, task)
            most = task.max_chunk_scans if isinstance(task, OpenableTask) else MAX_CHUNK_SCANS
            try:
                cut = chunks(scans, pool.workers, most)
                yield from _of_chunks(attempt, cut, pool, options.backend)
            finally:
                # Joblib kills processes, but cannot kill threads and does not wait for them.
                WORKER.end(context.run)


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
    attempt: Callable[[Chunk], list[Attempt]], cut: Iterable[Chunk], pool: WorkerPool, backend: str
) -> Generator[Attempt, None, None]:
    import joblib

    with joblib.parallel_config(**pool.backend):
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, pre_dispatch=pool.in_flight
        )
    try:
        with signals_blocked(signal.SIGINT, signal.SIGTERM) if backend == "loky" else nullcontext():
            attempts = parallel(joblib.delayed(attempt)(chunk) for chunk in cut)
        with closing(attempts):
            for of_chunk in attempts:
                yield from of_chunk
    except pool.died as error:
        subject, found = f"--backend {backend} --jobs {pool.workers}", "the system ended a worker"
        raise WorkersLost(subject, found, "memory for all of them", "use fewer jobs") from error


@dataclass(frozen=True, slots=True)
class NetworkTask:
    """Function of a scan and a network."""

    max_chunk_scans: ClassVar[int] = MAX_CHUNK_SCANS
    # Takes a scan file and a network; picklable. It returns the result or yields `ScanSteps`, which
    # overlap on a CPU
    function: Callable[[ScanFile, Network], Any]
    settings: NetworkSettings  # Resolved: what the workers load
    # The same, loaded in this process; it is not sent to others
    network: Network | None = field(default=None, compare=False)
    # Whether it yields the input of the network, and takes the softmax that is sent in
    takes_softmax: bool = False
    # Scans computed together; by default one on a CPU, as many as keep it busy on a GPU
    batch: int | None = None

    def open(self) -> AttemptFunction:
        """Load the network, unless it is there, and decide between one by one and batches."""
        network = self.network or _loaded(self.settings)
        on_cpu, in_steps = network.device == "cpu", isgeneratorfunction(self.function)
        pixels = network.sensor.height * network.sensor.width
        usual = 1 if on_cpu else max(1, min(MAX_BATCH_SCANS, MAX_BATCH_PIXELS // pixels))
        size = self.batch or usual

        def steps(file: ScanFile) -> ScanSteps:
            with named_if_too_large(file, network):
                if in_steps:
                    yield from self.function(file, network)
                else:
                    yield self.function(file, network)

        if self.takes_softmax and not (on_cpu and size == 1):
            return partial(softmax_in_batches, steps, network, size)
        if in_steps and on_cpu:
            return partial(overlapping, steps)
        return partial(one_by_one, lambda file: [*steps(file)][-1])

    def __reduce__(self) -> tuple[Any, ...]:
        return NetworkTask, (self.function, self.settings, None, self.takes_softmax, self.batch)


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
        on_cpu = network.device == "cpu"
        remedy = "free some memory, or use fewer --jobs" if on_cpu else "use --device cpu"
        found = f"is too large for the memory of {network.device}"
        raise FormatError(file.path, found, remedy=remedy) from error


def _step(file: ScanFile, steps: ScanSteps, softmax: Float | None = None) -> Attempt:
    """Attempt the next step of a scan, into which a softmax may be sent."""
    try:
        return file, steps.send(softmax), None
    except SalsanextError as error:
        return file, None, error


def softmax_in_batches(
    begin: Callable[[ScanFile], ScanSteps], network: Network, size: int, files: Iterable[ScanFile]
) -> Iterator[Attempt]:
    """Attempt so many scans at a time, their softmax computed together if memory suffices."""
    waiting = iter(files)
    while batch := tuple(islice(waiting, size)):
        begun, inputs = [], []
        for file in batch:
            steps = begin(file)
            _, given, error = _step(file, steps)
            if error:
                yield file, None, error
            else:
                begun.append((file, steps))
                inputs.append(given)
        softmax: Sequence[Float | None] = [None] * len(begun)
        with suppress(MemoryError):
            softmax = network.softmax(inputs)
        for (file, steps), of_image in zip(begun, softmax, strict=True):
            computed = _step(file, steps, of_image)
            yield computed if computed[2] else _step(file, steps)


def overlapping(
    begin: Callable[[ScanFile], ScanSteps], files: Iterable[ScanFile]
) -> Iterator[Attempt]:
    """Attempt scans in order; meanwhile a thread writes the last and reads the next."""
    pool = ThreadPoolExecutor(1, "salsanext-files")
    waiting = iter(files)

    def beside(file: ScanFile, steps: ScanSteps) -> Future[Attempt]:
        return pool.submit(copy_context().run, _step, file, steps)

    def read_next() -> tuple[ScanSteps, Future[Attempt]] | None:
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
                    file, _, error = _step(file, steps)
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
