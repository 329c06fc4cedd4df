# SPDX-License-Identifier: MIT
"""Workers of a run on a GPU whose number was not requested: as many as keep the GPU busy.

One process reads and writes more slowly than a GPU computes. The first scans are processed here,
and the share of the time in which this process waits for the GPU is measured. Workers process the
rest of a long run, if they end it sooner in spite of their start.
"""

import logging
import math
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from salsanext_cli.core.engines.gpu_memory import gpus_of_workers, processes_in_memory
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.texts import percentage
from salsanext_cli.runs.loop.job import Attempt, ScanJob, Task
from salsanext_cli.runs.loop.pipeline import Pipeline, Report
from salsanext_cli.runs.loop.run_options import RunOptions, cores
from salsanext_cli.runs.results.paths import ScanFile

MIN_SCANS = 500  # Fewest scans of a run for which workers are considered
WARM_UP_SCANS = 48  # Scans before the measurement, in which libraries load what they need
MEASURED_SCANS = 96
FIRST_SCANS = WARM_UP_SCANS + MEASURED_SCANS
START_S = 12.0  # Start of workers in seconds: the first result of eight on an H200 came after 11 s
CORES_PER_WORKER = 2  # A worker has threads that read and one that writes

Clock = Callable[[], float]

log = logging.getLogger(__name__)


@dataclass(slots=True, kw_only=True)
class TimedJob:
    """Job that adds up the time of its second step, in which a process waits for the device."""

    job: ScanJob[Any, Any, Any]
    clock: Clock
    seconds: float = field(default=0.0, init=False)

    def prepare(self, file: ScanFile) -> Any:
        """Prepare a scan."""
        return self.job.prepare(file)

    def compute(self, scans: Sequence[Any]) -> Sequence[Any]:
        """Compute a batch, and add up the time."""
        start = self.clock()
        computed = self.job.compute(scans)
        self.seconds += self.clock() - start
        return computed

    def finish(self, scan: Any, computed: Any) -> Any:
        """Finish a scan."""
        return self.job.finish(scan, computed)


@dataclass(slots=True, kw_only=True)
class MeasuredPipeline:
    """Pipeline on a GPU that measures its first scans.

    Attributes
    ----------
    pipeline : Pipeline
        Steps of a scan.
    clock : callable
        Returns the time in seconds.
    busy_share : float
        Share of the measured time in which the process waited for the device, 0…1.
    seconds_per_scan : float
        Time of a measured scan.
    """

    pipeline: Pipeline[Any, Any, Any]
    clock: Clock = time.monotonic
    busy_share: float = field(default=1.0, init=False)
    seconds_per_scan: float = field(default=0.0, init=False)

    def attempts(
        self, scans: Sequence[ScanFile], on_stop: Report
    ) -> Generator[Attempt[Any], None, None]:
        """Yield the attempts of `FIRST_SCANS` scans as of `Pipeline.run`, and measure the later."""
        timed = TimedJob(job=self.pipeline.job, clock=self.clock)
        start = self.clock()
        seconds_before = 0.0
        attempts = replace(self.pipeline, job=timed).run(scans, on_stop)
        for number, attempt in enumerate(attempts, start=1):
            yield attempt
            if number == WARM_UP_SCANS:
                start = self.clock()
                seconds_before = timed.seconds
        elapsed = self.clock() - start
        self.busy_share = (timed.seconds - seconds_before) / max(elapsed, 1e-9)
        self.seconds_per_scan = elapsed / MEASURED_SCANS


def needs_measurement(work: Any, scans: Sequence[ScanFile], options: RunOptions) -> bool:
    """Return whether the workers of a run are chosen by measurement: many scans on a GPU."""
    is_on_gpu = isinstance(work, Pipeline) and work.device != "cpu"
    return options.jobs is None and is_on_gpu and len(scans) >= MIN_SCANS


def attempts_as_needed(
    task: Task,
    pipeline: Pipeline[Any, Any, Any],
    scans: Sequence[ScanFile],
    options: RunOptions,
    on_stop: Report,
    on_workers: Callable[[int], object],
) -> Generator[Attempt[Any], None, None]:
    """Yield the attempts of all scans, the first of them and perhaps all from this process.

    Parameters
    ----------
    task : Task
        Task that workers open.
    pipeline : Pipeline
        The task, opened in this process.
    scans : sequence of ScanFile
        Scans of the run, at least `MIN_SCANS`.
    options : RunOptions
        Options of the run.
    on_stop : callable
        As of `Pipeline.run`.
    on_workers : callable
        Called with the number of workers, if there are any.

    Yields
    ------
    Attempt
    """
    measured = MeasuredPipeline(pipeline=pipeline)
    yield from measured.attempts(scans[:FIRST_SCANS], on_stop)
    rest = scans[FIRST_SCANS:]
    remaining_s = len(rest) * measured.seconds_per_scan
    gpus = gpus_of_workers(pipeline.device)
    workers = workers_for(measured.busy_share, remaining_s, cores(), gpus)
    workers = min(workers, processes_in_memory(pipeline.device))
    if workers < 2:
        yield from pipeline.run(rest, on_stop)
        return
    from salsanext_cli.runs.loop.pool import attempts_of_workers

    text = "%d processes label the other %s scans: one waits for the GPU %s of the time"
    log.log(NOTICE, text, workers, f"{len(rest):,}", percentage(measured.busy_share, 0))
    on_workers(workers)
    yield from attempts_of_workers(task, rest, replace(options, jobs=workers))


def workers_for(busy_share: float, remaining_s: float, core_count: int, gpus: int) -> int:
    """Return the number of workers that ends a run first.

    Parameters
    ----------
    busy_share : float
        Share of the time in which one process waits for the device, 0…1.
    remaining_s : float
        Time that one process would need for the remaining scans, in seconds.
    core_count : int
        Number of cores.
    gpus : int
        Number of GPUs that the workers share.

    Returns
    -------
    int
        At most one worker per `CORES_PER_WORKER`; 1 if more do not save time.
    """
    enough = math.ceil(gpus / max(busy_share, 1 / core_count))
    workers = max(1, min(enough, core_count // CORES_PER_WORKER))
    is_sooner = START_S + remaining_s / workers < remaining_s
    return workers if is_sooner else 1
