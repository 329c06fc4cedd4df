# SPDX-License-Identifier: MIT
"""Workers that a run on a GPU chooses by itself; the GPU and the clock are those of the tests."""

from collections.abc import Sequence
from dataclasses import dataclass

import pytest
from numbered_scans import scans_of

from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.runs.loop import measured_workers
from salsanext_cli.runs.loop.measured_workers import (
    FIRST_SCANS,
    MIN_SCANS,
    START_S,
    MeasuredPipeline,
    TimedJob,
    workers_for,
)
from salsanext_cli.runs.loop.pipeline import Pipeline
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.results.paths import ScanFile

MANY = scans_of([("00", number) for number in range(MIN_SCANS + 100)])
READING_S = 0.3  # Of a scan, in the time of the tests


class Clock:
    """Clock that stands still unless a step of a job moves it."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Job:
    """Job whose steps take the time of a clock."""

    clock: Clock
    computing_s: float

    def prepare(self, file: ScanFile) -> str:
        return file.stem

    def compute(self, scans: Sequence[str]) -> Sequence[str]:
        self.clock.now += self.computing_s * len(scans)
        return scans

    def finish(self, scan: str, computed: str) -> str:
        self.clock.now += READING_S
        return computed


@dataclass
class GpuTask:
    """Task that computes on a device that does not exist."""

    device: str = "cuda"
    max_chunk_scans: int = 16

    def open(self) -> Pipeline:
        job = Job(Clock(), computing_s=0.1)
        return Pipeline(job=job, batch=BatchSize(4, "scans"), device=self.device)


@pytest.fixture
def of_16_cores(monkeypatch, workers_in_process):
    """Choose workers for 16 cores, of which one process uses the GPU for a tenth of the time."""

    def measured(self, scans, on_stop):
        yield from self.pipeline.run(scans, on_stop)
        self.busy_share = 0.1
        self.seconds_per_scan = 0.5

    monkeypatch.setattr(MeasuredPipeline, "attempts", measured)
    monkeypatch.setattr(measured_workers, "cores", lambda: 16)
    monkeypatch.setattr(measured_workers, "processes_in_memory", lambda _: 99)


def test_the_time_of_a_step_is_added_up():
    clock = Clock()
    timed = TimedJob(job=Job(clock, computing_s=2.0), clock=clock)
    assert timed.compute(["a", "b"]) == ["a", "b"]
    assert timed.finish(timed.prepare(MANY[0]), "c") == "c"
    timed.compute(["d"])
    assert timed.seconds == pytest.approx(6.0)


def test_the_scans_after_the_first_are_measured():
    """Batches of one scan: each takes 0.1 s on the device, and 0.3 s to be written."""
    clock = Clock()
    pipeline = Pipeline(job=Job(clock, computing_s=0.1), device="cuda")
    measured = MeasuredPipeline(pipeline=pipeline, clock=clock)
    attempts = [*measured.attempts(MANY[:FIRST_SCANS], lambda _: None)]
    assert [attempt.file for attempt in attempts] == MANY[:FIRST_SCANS]
    assert measured.seconds_per_scan == pytest.approx(0.1 + READING_S, rel=0.05)
    assert measured.busy_share == pytest.approx(0.25, rel=0.05)


@pytest.mark.parametrize(
    ("busy_share", "remaining_s", "cores", "gpus", "expected"),
    [
        (0.3, 1000.0, 64, 2, 7),
        (1.0, 1000.0, 64, 8, 8),
        (0.3, 1000.0, 8, 4, 4),
        (0.1, 1000.0, 64, 1, 10),
        (0.1, 1000.0, 16, 1, 8),
        (0.3, 1000.0, 16, 1, 4),
        (1.0, 1000.0, 16, 1, 1),
        (0.0, 1000.0, 16, 1, 8),
        (0.1, 1000.0, 2, 1, 1),
        (0.1, START_S, 16, 1, 1),
        (0.5, 2 * START_S - 0.1, 16, 1, 1),
        (0.5, 2 * START_S + 0.1, 16, 1, 2),
    ],
)
def test_workers_are_few_and_must_save_time(busy_share, remaining_s, cores, gpus, expected):
    assert workers_for(busy_share, remaining_s, cores, gpus) == expected


@pytest.mark.usefixtures("of_16_cores")
def test_workers_label_the_rest_of_many_scans():
    results = []
    outcome = run_over_scans(GpuTask(), MANY, RunOptions(jobs=None), on_result=results.append)
    assert (outcome.done, outcome.workers) == (len(MANY), 8)
    assert sorted(results) == sorted(scan.stem for scan in MANY)


@pytest.mark.usefixtures("of_16_cores")
@pytest.mark.parametrize(
    ("task", "scans", "jobs"),
    [
        (GpuTask(), MANY[: MIN_SCANS - 1], None),
        (GpuTask(device="cpu"), MANY, None),
        (GpuTask(), MANY, 1),
    ],
)
def test_one_process_labels_few_scans_those_of_a_cpu_and_as_requested(task, scans, jobs):
    outcome = run_over_scans(task, scans, RunOptions(jobs=jobs))
    assert (outcome.done, outcome.workers) == (len(scans), 0)


@pytest.mark.usefixtures("of_16_cores")
def test_workers_fit_into_the_memory_of_the_gpu(monkeypatch):
    for fitting, expected in ((3, 3), (1, 0)):
        monkeypatch.setattr(measured_workers, "processes_in_memory", lambda _, n=fitting: n)
        outcome = run_over_scans(GpuTask(), MANY, RunOptions(jobs=None))
        assert (outcome.done, outcome.workers) == (len(MANY), expected)
