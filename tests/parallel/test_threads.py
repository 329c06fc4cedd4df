# SPDX-License-Identifier: MIT
from concurrent.futures import ThreadPoolExecutor

import numba
import pytest
import torch

from salsanext_cli.parallel.options import cores, threads_of_workers, use_threads, worker_count


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
