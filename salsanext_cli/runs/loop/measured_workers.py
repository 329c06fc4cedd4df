# SPDX-License-Identifier: MIT
"""Workers of a run on a GPU whose number was not requested: as many as keep the GPU busy.

One process reads and writes more slowly than a GPU computes. The first scans are processed here,
and it is measured for which share of the time the GPU computes them, and waits otherwise. Workers
process the rest of a long run, if they end it sooner in spite of their start.
"""

import logging
import math
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import Any

from salsanext_cli.core.engines.device_time import DeviceTime
from salsanext_cli.core.engines.gpu_memory import gpus_of_workers, processes_in_memory
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.texts import percentage
from salsanext_cli.runs.loop.job import Attempt, Task
from salsanext_cli.runs.loop.pipeline import Pipeline, Report
from salsanext_cli.runs.loop.run_options import RunOptions, cores
from salsanext_cli.runs.loop.timed_job import Clock, Pace, TimedJob
from salsanext_cli.runs.scans.scan_file import ScanFile

MIN_SCANS = 500  # Fewest scans of a run for which workers are considered
WARM_UP_SCANS = 48  # Scans before the measurement, in which libraries load what they need
MEASURED_SCANS = 96
FIRST_SCANS = WARM_UP_SCANS + MEASURED_SCANS
START_S = 12.0  # Start of workers in seconds: the first result of eight on an H200 came after 11 s
CORES_PER_WORKER = 2  # A worker has threads that read and one that writes

log = logging.getLogger(__name__)


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
    clock: Clock = time.monotonic,
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
    clock : callable
        Returns the time in seconds.

    Yields
    ------
    Attempt
    """
    timed = TimedJob(job=pipeline.job, device_time=DeviceTime(pipeline.device), clock=clock)
    yield from replace(pipeline, job=timed).run(scans[:FIRST_SCANS], on_stop)
    rest = scans[FIRST_SCANS:]
    pace = timed.pace(WARM_UP_SCANS)
    workers = 1 if pace is None else workers_at(pace, len(rest), pipeline.device)
    if pace is None or workers < 2:
        yield from pipeline.run(rest, on_stop)
        return
    from salsanext_cli.runs.loop.pool import attempts_of_workers

    text = "%d processes label the other %s scans: with one, the GPU waits %s of the time"
    log.log(NOTICE, text, workers, f"{len(rest):,}", percentage(1 - pace.busy_share, 0))
    on_workers(workers)
    yield from attempts_of_workers(task, rest, replace(options, jobs=workers))


def workers_at(pace: Pace, remaining: int, device: str) -> int:
    """Return the number of workers that ends a run of so many remaining scans first."""
    remaining_s = remaining * pace.seconds_per_scan
    workers = workers_for(pace.busy_share, remaining_s, cores(), gpus_of_workers(device))
    return min(workers, processes_in_memory(device))


def workers_for(busy_share: float, remaining_s: float, core_count: int, gpus: int) -> int:
    """Return the number of workers that ends a run first.

    Parameters
    ----------
    busy_share : float
        Share of the time for which the device computes the scans of one process, 0…1.
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
