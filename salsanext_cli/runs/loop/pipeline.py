# SPDX-License-Identifier: MIT
"""Overlap of the three steps of a job: reader threads, the calling thread, a writer thread.

While the calling thread computes a batch, the readers prepare the next scans and the writer
finishes the previous batch. An error belongs to one scan. The overlap is the same on CPUs and GPUs.
"""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Any, Generic, TypeVar

from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.engines.memory import out_of_gpu_memory, out_of_memory
from salsanext_cli.core.errors import FormatError, SalsanextError
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.runs.loop.job import Attempt, Computed, OpenableTask, Prepared, ScanJob, Task
from salsanext_cli.runs.scans.scan_file import ScanFile

Result = TypeVar("Result")
Value = TypeVar("Value")
Report = Callable[[Attempt[Any]], object]
AttemptFunction = Callable[[Iterable[ScanFile], Report], Generator[Attempt[Any], None, None]]
"""Work on scans as `Pipeline.run`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pipeline(Generic[Prepared, Computed, Result]):
    """Job on scans, and how its steps overlap.

    Parameters
    ----------
    job : ScanJob
        The three steps.
    batch : BatchSize
        Number of scans that are computed together.
    readers : int
        Number of threads that prepare scans.
    device : str
        Device that computes, for errors.
    """

    job: ScanJob[Prepared, Computed, Result]
    batch: BatchSize = field(default_factory=lambda: BatchSize(1, "scans"))
    readers: int = 1
    device: str = "cpu"

    def run(
        self, files: Iterable[ScanFile], on_stop: Report = lambda _: None
    ) -> Generator[Attempt[Result], None, None]:
        """Work on scans, and yield the attempts in the order of the files.

        In memory are the batch that is computed, the batch that is finished, and the prepared
        scans: a batch, or one scan per reader if that is more. An interrupt, an exception that is
        not a `SalsanextError`, or `close` ends the run after the scans that are being finished.

        Parameters
        ----------
        files : iterable of ScanFile
            Scans.
        on_stop : callable
            Called with each attempt that succeeded and that the end of the run keeps from being
            yielded.

        Yields
        ------
        Attempt
        """
        waiting = iter(files)
        reading: deque[Future[Attempt[Prepared]]] = deque()
        writing: deque[Future[Attempt[Result]]] = deque()
        readers = ThreadPoolExecutor(self.readers, "salsanext-reader")
        writer = ThreadPoolExecutor(1, "salsanext-writer")

        def read_ahead() -> None:
            missing = max(self.batch.most, self.readers) - len(reading)
            for file in islice(waiting, max(0, missing)):
                reading.append(_submit(readers, self._attempt, file, self.job.prepare, file))

        def next_batch() -> Iterator[Attempt[Prepared]]:
            for _ in range(min(self.batch.most, len(reading))):
                yield reading[0].result()
                reading.popleft()
                read_ahead()

        try:
            read_ahead()
            while reading or writing:
                computed = self._compute([*next_batch()])
                while writing:
                    finished = writing[0].result()
                    writing.popleft()
                    yield finished
                while computed:
                    writing.append(_submit(writer, self._finish, *computed.popleft()))
        except BaseException:
            for future in writing:
                if not future.exception() and not future.result().error:
                    on_stop(future.result())
            raise
        finally:
            for pool in (readers, writer):
                pool.shutdown(cancel_futures=True)

    def results(self, files: Iterable[ScanFile]) -> Iterator[Result]:
        """Yield the results of scans; raise the first error."""
        for attempt in self.run(files):
            yield attempt.get()

    def _compute(
        self, scans: Sequence[Attempt[Prepared]]
    ) -> deque[tuple[Attempt[Prepared], Attempt[Computed]]]:
        """Compute the scans that could be prepared."""
        usable = [scan for scan in scans if not scan.error]
        computed = chain.from_iterable(self.batch.in_batches(self._together, usable))
        return deque(
            (scan, Attempt(file=scan.file, error=scan.error) if scan.error else next(computed))
            for scan in scans
        )

    def _together(self, scans: Sequence[Attempt[Prepared]]) -> list[Attempt[Computed]]:
        """Compute scans in one batch; if that fails, compute each of them alone."""
        if len(scans) == 1:
            alone = scans[0]

            def compute() -> Computed:
                return self.job.compute([alone.get()])[0]

            return [self._attempt(alone.file, compute)]
        try:
            computed = self.job.compute([scan.get() for scan in scans])
        except SalsanextError:
            return [attempt for scan in scans for attempt in self._together([scan])]
        return [
            Attempt(file=scan.file, result=value)
            for scan, value in zip(scans, computed, strict=True)
        ]

    def _finish(self, scan: Attempt[Prepared], computed: Attempt[Computed]) -> Attempt[Result]:
        if computed.error:
            return Attempt(file=scan.file, error=computed.error)
        return self._attempt(scan.file, self.job.finish, scan.get(), computed.get())

    def _attempt(
        self, file: ScanFile, function: Callable[..., Value], *arguments: Any
    ) -> Attempt[Value]:
        """Call a function of a scan; a lack of memory is an error of the scan.

        Each step may need memory of the host and of the device: a scan is copied for the device in
        `prepare`, and may be computed again in `finish`.
        """
        try:
            return attempt(file, function, *arguments)
        except (MemoryError, RuntimeError) as error:
            if not out_of_memory(error):
                raise
            device = self.device if out_of_gpu_memory(error) else "cpu"
            hint = f"use {setting('device', 'cpu')}"
            if device == "cpu":
                hint = f"free some memory, or use fewer {argument('jobs')}"
            problem = f"is too large for the memory of {device}"
            return Attempt(file=file, error=FormatError(file.path, problem, hint=hint))


def attempt(file: ScanFile, function: Callable[..., Value], *arguments: Any) -> Attempt[Value]:
    """Call a function of a scan; a `SalsanextError` is the error of the attempt."""
    try:
        return Attempt(file=file, result=function(*arguments))
    except SalsanextError as error:
        return Attempt(file=file, error=error)


def opened(task: Task) -> AttemptFunction:
    """Open a task, and return a function that works on the scans of a chunk."""
    return attempt_function(opened_work(task))


def opened_work(task: Task) -> Any:
    """Open a task; return the function of one scan, or the pipeline of a job."""
    work = task.open() if isinstance(task, OpenableTask) else task
    return Pipeline(job=work) if isinstance(work, ScanJob) else work


def attempt_function(work: Any) -> AttemptFunction:
    """Return the function that works on scans by what `opened_work` returned."""
    if isinstance(work, Pipeline):
        return work.run

    def attempts(files: Iterable[ScanFile], _: Report) -> Generator[Attempt[Any], None, None]:
        for file in files:
            yield attempt(file, work, file)

    return attempts


def _submit(
    pool: ThreadPoolExecutor, function: Callable[..., Value], *arguments: Any
) -> Future[Value]:
    """Call a function in a thread with the context variables of this one."""
    return pool.submit(copy_context().run, function, *arguments)
