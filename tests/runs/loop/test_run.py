# SPDX-License-Identifier: MIT
"""Scans one after another and by local workers: order, errors, interrupts, memory."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from scans import write_sequence
from worker_runs import run
from worker_tasks import Opens, Write, scans_of

from salsanext_cli.core.errors import FormatError
from salsanext_cli.runs.loop.run import RunOptions, run_over_scans

LOCAL = pytest.mark.parametrize("options", [{}, {"jobs": 2}], ids=["1", "2"])


@LOCAL
def test_on_error_stop_raises_the_error_of_the_scan(tmp_path, options):
    scans = scans_of("a", "bad", *(f"{n:03d}" for n in range(100)))
    with pytest.raises(FormatError) as caught:
        run(Write(tmp_path, pause=0.05), scans, **options, on_error="stop")
    assert caught.value.subject.endswith("bad.bin")
    written = [path.name for path in (tmp_path / "s").iterdir()]
    assert "a" in written or options
    assert len(written) < 50
    assert not any(name.startswith(".") for name in written)


@LOCAL
def test_a_task_is_opened_once_by_each_worker_of_a_run(tmp_path, options):
    # Ctrl-C does not reach processes, because the process that runs them ends them.
    stems = [*"abcdefg", "ctrl-c" if options else "h"]
    for sequence in ("first", "second"):
        outcome = run(Opens(tmp_path), scans_of(*stems, sequence=sequence), **options)
        assert outcome.done == 8
        opened = (tmp_path / "opened").read_text().split()
        (tmp_path / "opened").unlink()
        assert len(opened) == len(set(opened)) <= 2
        if not options:
            assert opened == [str(os.getpid())]


def test_existing_results_are_skipped_unless_overwriting(tmp_path):
    work = Write(tmp_path)
    run(work, scans_of("a", "b"))
    (tmp_path / "s" / "a").write_bytes(b"mine")
    outcome = run(work, scans_of("a", "b", "c"))
    assert (outcome.done, outcome.skipped) == (1, 2)
    assert (tmp_path / "s" / "a").read_bytes() == b"mine"
    assert run(work, scans_of("a", "b", "c"), overwrite=True).done == 3
    assert (tmp_path / "s" / "a").read_bytes() == b"a"


def test_results_can_be_handed_on_as_they_come(tmp_path):
    work, taken, seen, progress = Write(tmp_path), [], [], []

    def note(*numbers):
        seen.append(len(taken))
        progress.append(numbers)

    chosen = RunOptions(jobs=2, progress=note)
    scans = scans_of("a", "bad", "b", "c")
    outcome = run_over_scans(work, scans, chosen, on_result=taken.append)
    assert sorted(taken) == list("abc")
    assert progress == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]
    assert sorted(seen) == seen
    assert seen[0] <= 1
    assert (outcome.done, len(outcome.failures)) == (3, 1)


@LOCAL
def test_an_interruption_leaves_whole_files_only(tmp_path, options):
    """Workers are killed while they write; partial files are removed."""
    timer = threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT))
    count = 0

    def arm(done, _):
        nonlocal count
        count = done
        if done == 2:
            timer.start()

    scans = scans_of(*(f"{n:03d}" for n in range(200)))
    with pytest.raises(KeyboardInterrupt):
        run(Write(tmp_path, pause=0.05), scans, **options, progress=arm)
    written = list((tmp_path / "s").iterdir())
    assert 2 <= count <= len(written) < 200
    for path in written:
        assert not path.name.startswith(".")
        assert path.read_text() == path.name
    again = run(Write(tmp_path), scans, **options)
    assert again.skipped == len(written)
    assert again.done == 200 - len(written)


PEAK = """
import os, resource, sys
from salsanext_cli.commands.line.app import app
os.fsync = os.fstat
try:
    app(sys.argv[1:])
except SystemExit as end:
    assert end.code == 0, end.code
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_of(command, scans, out, weights, count):
    """Return the most memory, KiB, of a command that does not wait for the disk."""
    line = [command, scans, out, "--weights", weights, "--limit", count, "-q"]
    words = [sys.executable, "-c", PEAK, *map(str, line)]
    on_cpu = {**os.environ, "CUDA_VISIBLE_DEVICES": ""}
    printed = subprocess.run(words, env=on_cpu, check=True, capture_output=True, text=True).stdout
    return int(printed.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.long
def test_the_peak_of_ten_times_the_scans_is_the_same(tmp_path, weights):
    scans = write_sequence(tmp_path / "drive", ["000000"], count=3000, labels=False) / "velodyne"
    for number in range(1, 2000):
        (scans / f"{number:06d}.bin").symlink_to(scans / "000000.bin")
    few, many = (
        peak_of("predict", scans, tmp_path / f"{count}", weights, count) for count in (200, 2000)
    )
    assert many <= 1.05 * few
