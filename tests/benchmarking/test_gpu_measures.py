# SPDX-License-Identifier: MIT
"""A run on a GPU ends in its time: what would take longer is skipped, and a run is ended."""

import io
import json
import subprocess
import sys
import time

import pytest

from benchmarks.gpu import gpu_predict, tests_in_time
from benchmarks.gpu.gpu_measures import NETWORK, Figures
from benchmarks.gpu.gpu_predict import Countdown, FolderRun
from benchmarks.gpu.gpu_use import mean_text, read_numbers, started, utilisation
from benchmarks.gpu.time_limit import TimeOverError, time_limit
from benchmarks.processes import ROOT
from salsanext_cli.commands.stages.predict import PredictOutcome
from salsanext_cli.runs.loop.measured_workers import FIRST_SCANS

TESTS = "def test_first():\n    raise AssertionError\n"


def figures(tmp_path, seconds: float) -> Figures:
    return Figures(tmp_path / "figures.json", "cpu", time.monotonic() + seconds)


def test_calls_that_would_not_end_in_time_are_skipped(tmp_path):
    """Of an unknown kind they take as long as so many passes of the network."""
    found = figures(tmp_path, 60.0)
    assert found.has_time_for_calls("a", "kNN", 1000)
    found.paces = {NETWORK: 0.01, "kNN": 0.001}
    assert found.has_time_for_calls("b", "kNN", 1000)
    assert not found.has_time_for_calls("c", "kNN", 40_000)
    assert found.has_time_for_calls("d", "labels", 1000, passes=2.0)
    assert not found.has_time_for_calls("e", "labels", 1000, passes=4.0)
    rows = json.loads((tmp_path / "figures.json").read_text())["figures"]
    assert [row["name"] for row in rows] == ["c", "e"]
    assert all(row["value"].startswith("skipped") for row in rows)


def test_a_call_is_timed_once_when_no_time_is_left(tmp_path):
    calls = []
    assert figures(tmp_path, 0.0).seconds(lambda: calls.append(1), 5) >= 0
    assert len(calls) == 2  # One warms up
    found = figures(tmp_path, 60.0)
    found.seconds_of("kind", 4, lambda: time.sleep(0.01), 3)
    assert found.paces["kind"] == pytest.approx(0.01 / 4, rel=1.0)


def test_a_run_over_a_folder_ends_with_its_time():
    countdown = Countdown(time.monotonic() + 60.0)
    countdown(0, 9)
    countdown(1, 9)
    countdown.end = 0.0
    with pytest.raises(TimeOverError):
        countdown(2, 9)
    assert countdown.counts == [1, 2]


def test_the_rate_of_workers_is_without_their_start(tmp_path, monkeypatch):
    """100 scans a second in one process, a start of 11 s, then 500 a second."""
    alone = [0.01 * number for number in range(1, FIRST_SCANS + 1)]
    times = alone + [alone[-1] + 11 + 0.002 * number for number in range(500)]

    def predict_scans(*_, options, **__):
        options.progress.readings += times
        return PredictOutcome(skipped=0, failures=(), done=len(times), workers=8)

    monkeypatch.setattr(gpu_predict, "predict_scans", predict_scans)
    measured = figures(tmp_path, 60.0)
    rate = gpu_predict.measure_run(measured, "run", None, tmp_path, FolderRun())
    assert rate == pytest.approx(500)
    values = {row["name"]: row["value"] for row in measured.rows}
    assert values["run, workers"] == 8
    assert values["run, start of the workers"] == pytest.approx(11)


@pytest.mark.slow
def test_tests_without_time_are_skipped(tmp_path):
    (tmp_path / "test_any.py").write_text(TESTS)
    words = ("-q", "-p", "no:cacheprovider", "-p", tests_in_time.__name__, "--rootdir", tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *map(str, words), str(tmp_path)],
        cwd=ROOT,
        env={tests_in_time.END: "0", "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 skipped" in done.stdout


def test_the_use_of_a_gpu_is_read_line_by_line():
    numbers: list[float] = []
    read_numbers(io.StringIO("10\n[N/A]\n 30\n\n"), numbers)
    assert numbers == [10.0, 30.0]
    assert mean_text(numbers) == 20.0
    assert mean_text([]) == "unknown"
    with utilisation("cpu") as used:
        pass
    assert used == []
    assert started(("no-such-program-at-all",)) is None


def test_a_part_ends_with_its_time_whatever_it_does(monkeypatch):
    """Also one that ends a measurement by the first interruption, and begins another."""
    monkeypatch.setattr("benchmarks.gpu.time_limit.AGAIN_S", 0.02)
    interruptions = 0
    with time_limit(time.monotonic() + 0.02):
        while interruptions < 2:
            try:
                time.sleep(5)
            except TimeOverError:
                interruptions += 1
    time.sleep(0.04)  # Nothing interrupts what follows.
