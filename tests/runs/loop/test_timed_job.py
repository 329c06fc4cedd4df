# SPDX-License-Identifier: MIT
"""Pace of a process on a GPU; the device and the clock are those of the tests."""

import pytest
from numbered_scans import scans_of
from slow_job import DeviceTimes, SlowJob, TestClock

from salsanext_cli.core.engines.batches import BatchSize
from salsanext_cli.runs.loop.pipeline import Pipeline
from salsanext_cli.runs.loop.timed_job import StartedBatch, TimedJob

SCANS = scans_of([("00", number) for number in range(400)])
"""So many that a batch that a thread finishes late changes the pace by a percent."""


def timed_job(times, *, computing_s=0.1, finishing_s=0.3):
    clock = TestClock()
    job = SlowJob(clock=clock, computing_s=computing_s, finishing_s=finishing_s)
    return TimedJob(job=job, device_time=DeviceTimes(times=times), clock=clock)


def test_the_steps_are_those_of_the_job():
    timed = timed_job([])
    assert timed.compute(["a", "b"]) == ["a", "b"]
    assert timed.finish(timed.prepare(SCANS[0]), "c") == "c"
    timed.compute(["d"])
    assert timed.batches == [
        StartedBatch(start_s=0.0, scans=2),
        StartedBatch(start_s=pytest.approx(0.5), scans=1),
    ]


@pytest.mark.parametrize("batch", [1, 4])
def test_the_pace_of_a_pipeline(batch):
    """The device needs 0.1 s of the 0.4 s of a scan, but waits within all batches but one."""
    times = [0.3 * batch] * (len(SCANS) // batch)
    times[-2] = 0.1 * batch
    timed = timed_job(times)
    attempts = [*Pipeline(job=timed, batch=BatchSize(batch, "scans")).run(SCANS)]
    assert [attempt.file for attempt in attempts] == SCANS
    pace = timed.pace(16)
    assert pace.seconds_per_scan == pytest.approx(0.4, rel=0.05)
    assert pace.busy_share == pytest.approx(0.25, rel=0.05)


def test_scans_are_counted_from_the_start_of_a_batch_to_that_of_another():
    timed = timed_job([9.0, 0.4, 0.2, 0.5])
    starts = [(0.0, 4), (5.0, 4), (7.0, 2), (8.0, 5)]
    timed.batches = [StartedBatch(start_s=start, scans=scans) for start, scans in starts]
    pace = timed.pace(3)
    assert pace.seconds_per_scan == pytest.approx(3.0 / 6)
    assert pace.busy_share == pytest.approx(0.1 / 0.5)
    assert timed.pace(9) is None
    assert timed.pace(100) is None


def test_a_batch_that_fails_is_not_measured():
    timed = timed_job([])
    timed.job.compute = lambda _: 1 / 0
    with pytest.raises(ZeroDivisionError):
        timed.compute(["a"])
    assert timed.batches == []
