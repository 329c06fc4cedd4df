# SPDX-License-Identifier: MIT
"""Threads and GPUs of workers; no GPU is needed, since their number is an argument."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numba
import pytest
import torch

from salsanext_cli.parallel import worker
from salsanext_cli.parallel.options import cores, threads_of_workers, use_threads, worker_count
from salsanext_cli.parallel.worker import WORKER


@pytest.fixture(autouse=True)
def as_before():
    before = torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS
    yield
    torch.set_num_threads(before[0])
    numba.config.NUMBA_NUM_THREADS = before[1]


def test_jobs():
    assert worker_count(3) == 3
    assert worker_count(-1) == cores() >= 1


def test_threads_begin_with_their_share_and_leave_the_others_alone():
    torch.set_num_threads(5)
    with threads_of_workers(3), ThreadPoolExecutor(2) as pool:
        seen = list(pool.map(lambda _: torch.get_num_threads(), range(4)))
        assert numba.config.NUMBA_NUM_THREADS == 3
    assert seen == [3] * 4
    assert torch.get_num_threads() == 5
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(torch.get_num_threads).result() == 5


def test_a_worker_of_a_cluster_sets_its_own():
    with ThreadPoolExecutor(1) as pool:
        pool.submit(use_threads, 2).result()
        assert pool.submit(torch.get_num_threads).result() == 2
    assert numba.config.NUMBA_NUM_THREADS == 2


ASK = """
import sys
from pathlib import Path
from salsanext_cli.parallel import worker
from salsanext_cli.parallel.worker import WORKER
WORKER.run = "a run"
worker._folder_of_numbers = lambda: Path(sys.argv[1])
print(worker.own_device("cuda", 2), worker.own_device("auto", 2), flush=True)
sys.stdin.read()
"""


def test_worker_processes_take_a_gpu_each_and_a_killed_one_leaves_it(tmp_path):
    def started():
        return subprocess.Popen(
            [sys.executable, "-c", ASK, str(tmp_path / "numbers")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    # Each reads until it is closed, and the system lets go of its lock.
    with started() as first, started() as second, started() as third:
        found = [process.stdout.readline().split() for process in (first, second, third)]
        assert sorted(found) == [["cuda:0"] * 2] * 2 + [["cuda:1"] * 2]
        odd = (first, second, third)[found.index(["cuda:1"] * 2)]
        odd.kill()
        odd.wait()
        with started() as fourth:
            assert fourth.stdout.readline() == "cuda:1 cuda:1\n"


def test_a_device_that_was_named_or_is_alone_or_of_no_worker_stays(monkeypatch):
    assert worker.own_device("auto", 4) == "auto"
    monkeypatch.setattr(WORKER, "run", "a run")
    for device, count in (("cpu", 4), ("cuda:3", 4), ("auto", 1), ("cuda", 0)):
        assert worker.own_device(device, count) == device
