# SPDX-License-Identifier: MIT
"""Workers that a run on a GPU chooses by itself; the GPU and the clock are those of the tests."""

from dataclasses import dataclass

import pytest
from numbered_scans import scans_of
from slow_job import SlowJob, TestClock

from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.core.engines.device_time import DeviceTime
from salsanext_cli.runs.loop import measured_workers
from salsanext_cli.runs.loop.measured_workers import MIN_SCANS, START_S, workers_for
from salsanext_cli.runs.loop.pipeline import Pipeline
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans
from salsanext_cli.runs.loop.timed_job import Pace, TimedJob

MANY = scans_of([("00", number) for number in range(MIN_SCANS + 100)])


@dataclass
class GpuTask:
    """Task that computes on a device that does not exist."""

    device: str = "cuda"
    max_chunk_scans: int = 16

    def open(self) -> Pipeline:
        job = SlowJob(clock=TestClock(), computing_s=0.1, finishing_s=0.3)
        return Pipeline(job=job, batch=BatchSize(4, "scans"), device=self.device)


@pytest.fixture
def of_16_cores(monkeypatch, workers_in_process):
    """Choose workers for 16 cores, of which one process uses the GPU for a tenth of the time."""
    pace = Pace(seconds_per_scan=0.5, busy_share=0.1)
    monkeypatch.setattr(TimedJob, "pace", lambda *_: pace)
    monkeypatch.setattr(measured_workers, "DeviceTime", lambda _: DeviceTime("cpu"))
    monkeypatch.setattr(measured_workers, "cores", lambda: 16)
    monkeypatch.setattr(measured_workers, "processes_in_memory", lambda _: 99)


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
def test_one_process_labels_all_scans_if_they_are_few_batches(monkeypatch):
    monkeypatch.setattr(TimedJob, "pace", lambda *_: None)
    outcome = run_over_scans(GpuTask(), MANY, RunOptions(jobs=None))
    assert (outcome.done, outcome.workers) == (len(MANY), 0)


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
