# SPDX-License-Identifier: MIT
"""Workers: how many, with which device, and with which scans."""

import subprocess
import sys
from itertools import pairwise
from multiprocessing import current_process

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numbered_scans import scans_of

from salsanext_cli.runs.loop.network_task import NetworkTask, device_of_worker
from salsanext_cli.runs.loop.pool import MAX_CHUNK_SCANS, MIN_CHUNKS_PER_WORKER, chunks
from salsanext_cli.runs.loop.run_options import cores, worker_count
from salsanext_cli.runs.network_settings import NetworkSettings


def test_jobs():
    assert worker_count(3) == 3
    assert worker_count(-1) == cores() >= 1


ASK = """
import sys
from multiprocessing import current_process
from pathlib import Path
from salsanext_cli.runs.loop import network_task
current_process().name = "LokyProcess-1"
network_task._folder_of_numbers = lambda: Path(sys.argv[1])
print(*(network_task.device_of_worker(name, 2) for name in ("cuda", "auto")), flush=True)
sys.stdin.read()
"""


def test_worker_processes_take_different_gpus_and_a_killed_one_leaves_it(tmp_path):
    def started():
        return subprocess.Popen(
            [sys.executable, "-c", ASK, str(tmp_path / "numbers")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    # Each reads until it is closed, when the system releases its lock.
    with started() as first, started() as second, started() as third:
        found = [process.stdout.readline().split() for process in (first, second, third)]
        assert sorted(found) == [["cuda:0"] * 2] * 2 + [["cuda:1"] * 2]
        odd = (first, second, third)[found.index(["cuda:1"] * 2)]
        odd.kill()
        odd.wait()
        with started() as fourth:
            assert fourth.stdout.readline() == "cuda:1 cuda:1\n"


def test_a_device_that_was_named_or_is_alone_or_of_no_worker_stays(monkeypatch):
    assert device_of_worker("auto", 4) == "auto"
    monkeypatch.setattr(current_process(), "name", "LokyProcess-1")
    for device, count in (("cpu", 4), ("cuda:3", 4), ("auto", 1), ("cuda", 0)):
        assert device_of_worker(device, count) == device


@given(st.lists(st.integers(0, 120), max_size=6), st.integers(1, 40))
def test_chunks_hold_every_scan_in_order_and_are_alike_within_a_sequence(lengths, workers):
    scans = scans_of((f"{s:02d}", n) for s, length in enumerate(lengths) for n in range(length))
    found = chunks(scans, workers)
    assert [scan for chunk in found for scan in chunk] == scans
    assert len(found) >= min(len(scans), MIN_CHUNKS_PER_WORKER * workers)
    for chunk in found:
        assert len({scan.sequence for scan in chunk}) == 1
        assert 1 <= len(chunk) <= MAX_CHUNK_SCANS
    for one, other in pairwise(found):
        assert one[0].sequence != other[0].sequence or abs(len(one) - len(other)) <= 1


@pytest.mark.parametrize(
    ("device", "batch", "expected"),
    [("cpu", None, 16), ("cpu", 5, 16), ("cuda", None, 64), ("cuda:1", 5, 20)],
)
def test_a_worker_of_a_gpu_is_sent_several_batches(device, batch, expected):
    settings = NetworkSettings(None, device)
    assert NetworkTask(job=len, settings=settings, batch=batch).max_chunk_scans == expected
